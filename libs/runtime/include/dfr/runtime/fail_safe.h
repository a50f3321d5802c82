#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace dfr::runtime {

/// What a robot is doing, as far as the program that drives it is concerned.
enum class RunState {
  kIdle,        ///< Nothing is asked of it.
  kArmed,       ///< All is well, and an operator has said that it may move.
  kRunning,     ///< The learned policy drives it.
  kRecovering,  ///< A recovery drives it.
  kHolding,     ///< It stands still: this episode is over, for the cause that was logged.
  kFaulted,     ///< It stands still: a device or the program itself cannot be relied on.
};
inline constexpr int kNumRunStates = static_cast<int>(RunState::kFaulted) + 1;

/// "idle", "armed", "running", "recovering", "holding", "faulted".
[[nodiscard]] const char* Name(RunState state) noexcept;

/// Why a robot is made to stand still. From kEmergencyStop on they are faults.
enum class HoldReason {
  kNone,
  kOperator,          ///< An operator asked for it.
  kControllerHalted,  ///< The controller has no control that it takes for safe.
  kNotSeen,           ///< The image shows no line or no tip.
  kStateInvalid,      ///< The state has a non-finite entry.
  kStateJump,         ///< From one state to the next it moved further than a control can move it.
  kControlInvalid,    ///< The controller's control has a non-finite entry.
  kCommandRefused,    ///< Beyond a limit of speed, workspace or joints.
  kEmergencyStop,     ///< Its button was pressed.
  kEmergencyStopSilent,  ///< Nothing is heard of the button, so it could not stop anything.
  kArmSilent,            ///< No measured state arrives.
  kArmInvalid,           ///< Measured state that the console marks invalid, or that is not finite.
  kArmOld,               ///< Measured state that is too old.
  kArmJump,              ///< Measured state that moved faster than the arm can.
  kArmNotReady,          ///< Its operating state is not ENABLED and homed, or it has failed.
  kArmNotFollowing,      ///< It does not go where it is sent.
  kSecondCommander,      ///< Another program commands the arm, too.
  kClock,                ///< Stamps lie in the future: a clock has jumped.
  kImageSilent,          ///< No picture arrives.
  kImageOld,             ///< The newest picture is too old.
  kImageInvalid,         ///< Frozen, black, or of another size or kind.
  kOverrun,              ///< The control loop was late: what it knows is old.
  kRecorder,             ///< The run can no longer be recorded.
  kPlatform,             ///< What moves the target cannot be told to.
};
inline constexpr int kNumHoldReasons = static_cast<int>(HoldReason::kPlatform) + 1;

/// "operator", "controller-halted", ...: what logs and the operator read.
[[nodiscard]] const char* Name(HoldReason reason) noexcept;
/// Whether it leads to kFaulted, not to kHolding.
[[nodiscard]] bool IsFault(HoldReason reason) noexcept;

/// One change of state, with its cause.
struct Transition {
  std::int64_t steady_ns = 0;
  RunState from = RunState::kIdle;
  RunState to = RunState::kIdle;
  HoldReason reason =
      HoldReason::kNone;          ///< kNone where nothing is wrong: arming, starting, completing.
  std::array<char, 96> detail{};  ///< In words, cut if need be; zero-terminated.
};

/// Options for FailSafe.
struct FailSafeOptions {
  double max_period_s = 0.05;  ///< From one Tick() to the next, > 0.
  /// Seconds without a reason to hold before it can be armed, >= 0.
  double calm_s = 0.3;
};

/// The state machine between a control loop and a robot, which fails into hold: for any HoldReason
/// the robot stands still, and only an operator's explicit word makes it move again.
///
///   Arm()    idle, holding -> armed, if there was no reason to hold for calm_s
///   Start()  armed -> running
///   Hold()   armed, running, recovering -> holding, or faulted if it IsFault();
///            holding -> faulted if it IsFault(); idle stays idle, and cannot be armed
///   Done()   running, recovering -> idle: the task is completed
///   Clear()  faulted -> idle, if there was no reason to hold for calm_s
///
/// The loop calls Tick() first in every period, then Hold() for all that it finds, and moves the
/// robot only if may_move(). A loop that comes too late is a reason itself.
///
/// Nothing here allocates, locks or throws but the constructor. One object belongs to one thread.
class FailSafe {
 public:
  /// @throws std::invalid_argument naming the option that is out of range.
  explicit FailSafe(const FailSafeOptions& options);

  /// A new period begins at `steady_ns`, by a clock that never goes back.
  void Tick(std::int64_t steady_ns) noexcept;
  /// There is a reason to hold now. The first of a period decides the cause; a fault after a lesser
  /// reason still counts. `detail` is shown to the operator.
  void Hold(HoldReason reason, std::string_view detail = {}) noexcept;

  /// False, and nothing changes, if it may not be armed: blocking() says why.
  [[nodiscard]] bool Arm() noexcept;
  [[nodiscard]] bool Start() noexcept;
  void Done() noexcept;
  [[nodiscard]] bool Clear() noexcept;
  /// Whether a recovery drives now, or the policy. Without effect in other states.
  void Recovering(bool recovering) noexcept;

  [[nodiscard]] RunState state() const noexcept { return state_; }
  [[nodiscard]] bool may_move() const noexcept {
    return state_ == RunState::kRunning || state_ == RunState::kRecovering;
  }
  /// The last reason to hold, if it is at most calm_s old; kNone: nothing prevents arming.
  [[nodiscard]] HoldReason blocking() const noexcept;
  /// Its detail: valid until the next Hold().
  [[nodiscard]] std::string_view blocking_detail() const noexcept;

  /// Takes the oldest transition that was not taken. False if there is none. Of more than 64 that
  /// were not taken the newest are lost: lost_transitions().
  [[nodiscard]] bool Take(Transition& transition) noexcept;
  [[nodiscard]] std::int64_t lost_transitions() const noexcept { return lost_; }

 private:
  void Enter(RunState to, HoldReason reason, std::string_view detail) noexcept;

  std::int64_t max_period_ns_;
  std::int64_t calm_ns_;
  RunState state_ = RunState::kIdle;
  bool ticked_ = false;
  std::int64_t now_ns_ = 0;
  HoldReason last_reason_ = HoldReason::kNone;
  std::int64_t last_reason_ns_ = 0;
  std::array<char, 96> last_detail_{};
  std::array<Transition, 64> log_{};
  std::size_t log_begin_ = 0;
  std::size_t log_size_ = 0;
  std::int64_t lost_ = 0;
};

}  // namespace dfr::runtime
