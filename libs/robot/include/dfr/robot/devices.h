#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "dfr/runtime/fail_safe.h"

/// Device interfaces of a ControlLoop, implemented by drivers, simulators and tests. All calls come
/// from the loop's thread. No call may allocate, lock, wait (except Clock::Wait()) or throw. A
/// device that needs any of these operations must perform them in a separate thread.
namespace dfr::robot {

/// Result of a device check: kNone, or a reason to hold.
struct Finding {
  runtime::HoldReason reason = runtime::HoldReason::kNone;
  /// Description for the operator. Valid until the next call of the device.
  std::string_view detail = {};

  [[nodiscard]] bool ok() const noexcept { return reason == runtime::HoldReason::kNone; }
};

/// Result and time of the last check by a device's thread.
struct ThreadHealth {
  Finding finding;
  std::int64_t checked_ns = 0;  ///< Clock::MachineNs() at the check. If old, the thread hangs.
};

/// Clock of a control loop. In real time it advances independently; in lock-step with a simulator
/// only Wait() advances it.
class Clock {
 public:
  virtual ~Clock() = default;

  /// Waits until the next period begins. In lock-step the period begins `dt_s` later; in real time
  /// periods have a fixed length.
  [[nodiscard]] virtual Finding Wait(double dt_s) noexcept = 0;
  /// Returns the monotonic time of the loop, ns.
  [[nodiscard]] virtual std::int64_t SteadyNs() const noexcept = 0;
  /// Returns the time of the loop as used in sample stamps, ns since the Unix epoch.
  [[nodiscard]] virtual std::int64_t WallNs() const noexcept = 0;
  /// Returns the time of this machine's steady clock, ns, used for threads and operators.
  [[nodiscard]] virtual std::int64_t MachineNs() const noexcept = 0;

  [[nodiscard]] virtual bool lock_step() const noexcept { return false; }
  /// In lock-step: waits until the robot has executed all commands and is at rest.
  [[nodiscard]] virtual Finding Rest() noexcept { return {}; }
};

/// An arm. Sends set-points while armed and holds otherwise.
class Manipulator {
 public:
  virtual ~Manipulator() = default;

  /// Called once per period: processes measurements and sends the next set-point. Returns the
  /// reason why an armed arm must hold, or the reason that prevents arming.
  [[nodiscard]] virtual Finding Tick(std::int64_t steady_ns, std::int64_t wall_ns) noexcept = 0;
  /// True if the only problem found by the last Tick() is that the arm is not powered or not homed.
  /// Home() corrects this.
  [[nodiscard]] virtual bool needs_homing() const noexcept = 0;
  /// Starts to power up and home the arm, or returns the reason for a refusal. The arm moves.
  [[nodiscard]] virtual Finding Home() noexcept = 0;
  /// True while the arm powers up or homes.
  [[nodiscard]] virtual bool homing() const noexcept = 0;
  /// Starts sending set-points, beginning with the current one, or returns the reason for a
  /// refusal.
  [[nodiscard]] virtual Finding Arm() noexcept = 0;
  /// Stops set-points and homing at the next Tick(). Always succeeds.
  virtual void Hold() noexcept = 0;
  /// Starts a motion to `joints` (in the arm's units) of duration `duration_s`, or returns the
  /// reason for a refusal.
  [[nodiscard]] virtual Finding MoveTo(std::span<const double> joints,
                                       double duration_s) noexcept = 0;
  [[nodiscard]] virtual bool armed() const noexcept = 0;
  /// True while a motion is in progress.
  [[nodiscard]] virtual bool moving() const noexcept = 0;
  /// True if no motion is in progress and the measured joints rest at the set-point.
  [[nodiscard]] virtual bool at_rest() const noexcept = 0;
};

/// Measures the state from pictures.
class Camera {
 public:
  enum class Answer {
    kPending,  ///< Not available yet.
    kNotSeen,  ///< The picture does not show the state; its entries are NaN.
    kSeen,
  };
  virtual ~Camera() = default;

  /// Returns the last check of the picture stream by the camera's thread.
  [[nodiscard]] virtual ThreadHealth Report() noexcept = 0;
  /// Requests the state in the first picture stamped `after_ns` (ns since the Unix epoch) or later.
  /// Replaces a pending request.
  [[nodiscard]] virtual Finding Ask(std::int64_t after_ns) noexcept = 0;
  /// Writes the state unless the answer is kPending.
  [[nodiscard]] virtual Answer Take(std::span<double> state) noexcept = 0;
};

/// Receives the emergency stop and reports the loop's state to the operator's programs.
class EmergencyStop {
 public:
  virtual ~EmergencyStop() = default;

  /// Returns kEmergencyStop from a press on until Acknowledge(), even if the button was released.
  [[nodiscard]] virtual ThreadHealth Report() noexcept = 0;
  /// Called once per period: signals that the loop is alive and reports its state.
  virtual void Beat(runtime::RunState state) noexcept = 0;
  /// Confirms that the operator has noticed the stop. Ends the report of a released button.
  virtual void Acknowledge() noexcept = 0;
};

/// Moves the target. The platform rests unless commanded to move, and stops when commanded.
class Platform {
 public:
  virtual ~Platform() = default;

  /// Called once per period: checks whether the platform still accepts commands.
  [[nodiscard]] virtual Finding Check() noexcept = 0;
  /// Starts the motion home, or returns the reason for a refusal.
  [[nodiscard]] virtual Finding Home() noexcept = 0;
  /// Starts the motion, which lasts until Rest(), or returns the reason for a refusal.
  [[nodiscard]] virtual Finding Begin() noexcept = 0;
  /// Called in every period in which the robot must not move. Moves the platform by the shortest
  /// path to a known position, and stops it there. From an unknown position, the path leads home.
  /// No effect if the platform rests. Returns a reason if the platform cannot be commanded.
  [[nodiscard]] virtual Finding Rest() noexcept = 0;
};

/// Records the transitions of a run.
class Recorder {
 public:
  virtual ~Recorder() = default;

  virtual void Write(const runtime::Transition& transition, std::int64_t wall_ns) noexcept = 0;
  /// Called once per period with the findings of the arm and the emergency stop, and the loop's
  /// state.
  virtual void Period(const Finding& /*arm*/, const Finding& /*stop*/, runtime::RunState /*state*/,
                      std::int64_t /*wall_ns*/) noexcept {}
  /// True if recording is no longer possible.
  [[nodiscard]] virtual bool failed() const noexcept = 0;
};

/// Motion of the arm that executes one control.
struct Motion {
  std::span<const double> joints;  ///< Target of the arm. Valid until the next Plan().
  double duration_s = 0.0;
  std::span<const double> change;  ///< Expected change of the first entries of the state.
};

/// Translates controls into motions of the arm.
class Task {
 public:
  virtual ~Task() = default;

  [[nodiscard]] virtual int state_dim() const noexcept = 0;
  [[nodiscard]] virtual int control_dim() const noexcept = 0;
  /// Called after arming: the next motion begins at the arm's current position.
  virtual void Begin() noexcept = 0;
  /// Plans the motion of `control` (control_dim() finite entries) from the end of the last motion.
  /// Returns std::nullopt if the arm cannot reach the target.
  [[nodiscard]] virtual std::optional<Motion> Plan(std::span<const double> control) noexcept = 0;
};

}  // namespace dfr::robot
