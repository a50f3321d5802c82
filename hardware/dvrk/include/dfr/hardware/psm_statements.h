#pragma once

#include <cstdint>

namespace dfr::hardware {

/// Decides which of the console's statements of control (control_statement.h) answer this client's
/// commands. The console states each change of control, so a command causes at most one statement.
/// A hold of this client causes a statement of a control other than poses. The first set-point
/// after the hold causes a statement of poses. Any other statement shows that the console has
/// obeyed another client's command.
///
/// The client must not send a set-point while the answer to its hold may still arrive (see
/// awaits()). A statement of a control other than poses that arrives after a set-point therefore
/// never answers a hold of this client.
///
/// Never allocates. Times are of a monotonic clock.
class PsmStatements {
 public:
  /// Maximum time from a hold to its answer, ns. DDS requests a lost sample again after 0.1 s.
  static constexpr std::int64_t kLongest = 1'000'000'000;

  /// Records that `hold` is sent.
  void Held(std::int64_t now_ns) noexcept;
  /// Records that the arm is armed: set-points follow.
  void Armed() noexcept { poses_ = true; }
  /// Records that the console's control may have changed since this client's hold.
  void Unsettle() noexcept { held_last_ = false; }

  /// Processes the statements received since the last call. Returns true if all may be answers to
  /// this client's commands.
  [[nodiscard]] bool Take(int poses, int others, std::int64_t now_ns) noexcept;

  /// True while the answer to a hold of this client may still arrive, as of the last Take(). A hold
  /// that changes no control has no answer: the result is then true until kLongest has passed. A
  /// repeated hold of this client does not start the wait again.
  [[nodiscard]] bool awaits() const noexcept { return awaits_; }

 private:
  std::int64_t held_ns_ = 0;
  bool awaits_ = false;
  bool poses_ = false;  // true if one statement of poses may still arrive
  bool held_last_ =
      false;  // true if this client's hold set the present control, so a further hold has no answer
};

}  // namespace dfr::hardware
