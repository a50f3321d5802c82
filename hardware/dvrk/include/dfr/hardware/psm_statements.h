#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace dfr::hardware {

/// Decides which of the console's statements of control, see control_word.h, are answers to own
/// commands. The console states each change of control, so a command causes at most one statement:
/// an own hold one of another control than poses, the first set-point after it one of poses. The
/// arm may be armed again when an answer comes. Any statement beyond these shows that the console
/// has obeyed another's command.
///
/// Statements come in order. Therefore the answer to a set-point ends the wait for the answers to
/// earlier commands. The wait for the answer to a hold also ends after kLongest.
///
/// Never allocates. Times are of a monotonic clock.
class PsmStatements {
 public:
  /// Maximum time from a command to its answer, ns. A lost sample is requested again after 0.1 s.
  static constexpr std::int64_t kLongest = 1'000'000'000;

  /// Records that `hold` is sent.
  void Held(std::int64_t now_ns) noexcept;
  /// Records that a state command has ended. Its last answer may still come.
  void Requested(std::int64_t now_ns) noexcept;
  /// Records that the arm is armed: set-points follow.
  void Armed(std::int64_t now_ns) noexcept;
  /// Records the first command of the jaw since then.
  void JawMoved(std::int64_t now_ns) noexcept;
  /// Records that the console's control may no longer be that of an own hold.
  void Unsettle() noexcept { held_last_ = false; }

  /// Processes the statements received since the last call. Returns true if all may be answers to
  /// own commands.
  [[nodiscard]] bool Take(int poses, int others, std::int64_t now_ns) noexcept;

 private:
  // A hold or state command, and the set-points after it.
  struct Round {
    std::int64_t since_ns = 0;
    int others = 0;      // statements of another control than poses that may come
    bool poses = false;  // one of poses may come after these
  };

  Round& Begin(std::int64_t now_ns) noexcept;
  Round& Last(std::int64_t now_ns) noexcept;
  void Drop(std::size_t index) noexcept;
  void Forget(std::int64_t now_ns) noexcept;

  std::array<Round, 16> rounds_;
  std::size_t size_ = 0;
  bool held_last_ =
      false;  // the control is that of an own hold, which another hold leaves as it is
};

}  // namespace dfr::hardware
