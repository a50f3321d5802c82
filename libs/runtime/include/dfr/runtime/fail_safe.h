#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace dfr::runtime {

/// State of a robot, as seen by the program that drives it.
enum class RunState {
  kIdle,        ///< No command is active.
  kArmed,       ///< No fault; an operator has permitted motion.
  kRunning,     ///< The learned policy drives the robot.
  kRecovering,  ///< A recovery drives the robot.
  kHolding,     ///< The robot stands still: the episode ended for the logged cause.
  kFaulted,     ///< The robot stands still: a device or the program is unreliable.
};

/// "idle", "armed", "running", "recovering", "holding", "faulted".
[[nodiscard]] const char* Name(RunState state) noexcept;

/// Reasons to stop the robot. All reasons from kEmergencyStop on are faults.
enum class HoldReason {
  kNone,
  kOperator,             ///< Requested by an operator.
  kControllerHalted,     ///< The controller found no control that it considers safe.
  kNotSeen,              ///< The image does not show the line or the tip.
  kStateInvalid,         ///< The state has a non-finite entry.
  kStateJump,            ///< The change of the state is too large for one control.
  kControlInvalid,       ///< The control has a non-finite entry.
  kCommandRefused,       ///< The command exceeds a limit of speed, workspace or joints.
  kEmergencyStop,        ///< The emergency stop button was pressed.
  kEmergencyStopSilent,  ///< No message arrives from the button, so it could not stop the robot.
  kArmSilent,            ///< No measured state arrives.
  kArmInvalid,           ///< The measured state is not finite, or the console marks it invalid.
  kArmOld,               ///< The measured state is too old.
  kArmJump,              ///< The measured state changed faster than the arm can move.
  kArmNotReady,          ///< The operating state is not ENABLED and homed, or the arm has failed.
  kArmNotFollowing,      ///< The arm does not follow its set-points.
  kSecondCommander,      ///< Another program commands the arm.
  kClock,                ///< Stamps lie in the future: a clock jumped.
  kImageSilent,          ///< No image arrives.
  kImageOld,             ///< The newest image is too old.
  kImageInvalid,         ///< The image is frozen, black, or of wrong size or format.
  kOverrun,              ///< The control loop was late; its data are old.
  kRecorder,             ///< The run can no longer be recorded.
  kPlatform,             ///< The platform cannot be commanded.
};
inline constexpr int kNumHoldReasons = static_cast<int>(HoldReason::kPlatform) + 1;

/// Returns "operator", "controller-halted", ..., as used in logs and for the operator.
[[nodiscard]] const char* Name(HoldReason reason) noexcept;
/// Returns true if the reason leads to kFaulted, false if it leads to kHolding.
[[nodiscard]] bool IsFault(HoldReason reason) noexcept;

/// A change of state and its cause.
struct Transition {
  std::int64_t steady_ns = 0;
  RunState from = RunState::kIdle;
  RunState to = RunState::kIdle;
  HoldReason reason = HoldReason::kNone;  ///< kNone unless a reason to hold caused the change.
  std::array<char, 96> detail{};          ///< Description; truncated if necessary, zero-terminated.
};

/// Options for FailSafe.
struct FailSafeOptions {
  double max_period_s = 0.05;  ///< Maximum time between two calls of Tick(), in (0, 10].
  /// Minimum time without a reason to hold before arming, in [0, 60].
  double settle_time_s = 0.3;
};

/// State machine between a control loop and a robot. Fails safe: any HoldReason stops the robot,
/// and only an explicit operator command lets it move again.
///
///   Arm()    idle, holding -> armed, if there was no reason to hold for settle_time_s
///   Start()  armed -> running
///   Hold()   armed, running, recovering -> holding, or faulted if it IsFault();
///            holding -> faulted if it IsFault(); idle stays idle, and cannot be armed
///   Done()   running, recovering -> idle: the task is completed
///   Clear()  faulted -> idle, if there was no reason to hold for settle_time_s
///
/// In every period, the loop first calls Tick(), then Hold() for each reason found. The loop moves
/// the robot only if may_move(). A late loop is a reason to hold.
///
/// Only the constructor may allocate, lock or throw. One object belongs to one thread.
class FailSafe {
 public:
  /// @throws std::invalid_argument naming the option that is out of range.
  explicit FailSafe(const FailSafeOptions& options);

  /// Starts a period at `steady_ns`, by a monotonic clock.
  void Tick(std::int64_t steady_ns) noexcept;
  /// Reports a reason to hold in this period. The first reason is the cause of the transition. A
  /// later fault overrides a reason that is not a fault. `detail` is shown to the operator.
  void Hold(HoldReason reason, std::string_view detail = {}) noexcept;

  /// Returns false, without any change, if arming is not permitted; see blocking().
  [[nodiscard]] bool Arm() noexcept;
  [[nodiscard]] bool Start() noexcept;
  void Done() noexcept;
  [[nodiscard]] bool Clear() noexcept;
  /// Enters kRecovering or returns to kRunning. No effect in other states.
  void Recovering(bool recovering) noexcept;

  [[nodiscard]] RunState state() const noexcept { return state_; }
  [[nodiscard]] bool may_move() const noexcept {
    return state_ == RunState::kRunning || state_ == RunState::kRecovering;
  }
  /// Returns the last reason to hold if it is at most settle_time_s old, otherwise kNone. Arm()
  /// fails unless it is kNone.
  [[nodiscard]] HoldReason blocking() const noexcept;
  /// Returns the detail of blocking(). Valid until the next Hold().
  [[nodiscard]] std::string_view blocking_detail() const noexcept;

  /// Takes the oldest pending transition. Returns false if there is none. The queue holds 64
  /// transitions; further ones are lost.
  [[nodiscard]] bool Take(Transition& transition) noexcept;

 private:
  void Enter(RunState to, HoldReason reason, std::string_view detail) noexcept;

  std::int64_t max_period_ns_;
  std::int64_t settle_ns_;
  RunState state_ = RunState::kIdle;
  bool ticked_ = false;
  std::int64_t now_ns_ = 0;
  HoldReason last_reason_ = HoldReason::kNone;
  std::int64_t last_reason_ns_ = 0;
  std::array<char, 96> last_detail_{};
  std::array<Transition, 64> log_{};
  std::size_t log_begin_ = 0;
  std::size_t log_size_ = 0;
};

}  // namespace dfr::runtime
