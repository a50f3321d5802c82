#pragma once

#include <cstdint>

namespace dfr::hardware {

/// Decides which of the console's statements of control, see control_statement.h, are answers to
/// own commands. The console states each change of control, so a command causes at most one
/// statement: an own hold one of another control than poses, the first set-point after it one of
/// poses. Any statement beyond these shows that the console has obeyed another's command.
///
/// No set-point may be sent while the answer to an own hold may still come, see awaits(). Then a
/// statement of another control than poses that comes after a set-point is never an own answer,
/// whether or not the console has answered the hold.
///
/// Never allocates. Times are of a monotonic clock.
class PsmStatements {
 public:
  /// Maximum time from a hold to its answer, ns. A lost sample is requested again after 0.1 s.
  static constexpr std::int64_t kLongest = 1'000'000'000;

  /// Records that `hold` is sent.
  void Held(std::int64_t now_ns) noexcept;
  /// Records that the arm is armed: set-points follow.
  void Armed() noexcept { poses_ = true; }
  /// Records that the console's control may no longer be that of an own hold.
  void Unsettle() noexcept { held_last_ = false; }

  /// Processes the statements received since the last call. Returns true if all may be answers to
  /// own commands.
  [[nodiscard]] bool Take(int poses, int others, std::int64_t now_ns) noexcept;

  /// True while the answer to an own hold may still come, as of the last Take(). A hold that
  /// changes no control has none; this is then true until kLongest has passed, except after another
  /// own hold.
  [[nodiscard]] bool awaits() const noexcept { return awaits_; }

 private:
  std::int64_t held_ns_ = 0;
  bool awaits_ = false;
  bool poses_ = false;  // one statement of poses may come
  bool held_last_ =
      false;  // the control is that of an own hold, which another hold does not change
};

}  // namespace dfr::hardware
