#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "dfr/runtime/fail_safe.h"

/// The devices of a ControlLoop, as interfaces that drivers, simulators and tests implement. All
/// calls come from the loop's thread. None of them may allocate, lock, wait (Clock::Wait()
/// excepted) or throw; a device that has to gives that work to a thread of its own.
namespace dfr::robot {

/// What a device found: kNone, or a reason to hold.
struct Finding {
  runtime::HoldReason reason = runtime::HoldReason::kNone;
  std::string_view detail = {};  ///< For the operator. Valid until the next call of the device.

  [[nodiscard]] bool ok() const noexcept { return reason == runtime::HoldReason::kNone; }
};

/// What the thread of a device found, and when.
struct ThreadFinding {
  Finding finding;
  std::int64_t checked_ns = 0;  ///< By Clock::MachineNs(). Too long ago: the thread hangs.
};

/// The time of a control loop. In real time it passes by itself; in lock-step with a simulator it
/// passes in Wait() only.
class Clock {
 public:
  virtual ~Clock() = default;

  /// Returns when the next period begins, `dt_s` later where the loop decides how time passes; in
  /// real time periods have a fixed length.
  [[nodiscard]] virtual Finding Wait(double dt_s) noexcept = 0;
  /// The loop's time, ns. Never goes back.
  [[nodiscard]] virtual std::int64_t SteadyNs() const noexcept = 0;
  /// The loop's time as samples are stamped, ns since the Unix epoch.
  [[nodiscard]] virtual std::int64_t WallNs() const noexcept = 0;
  /// This machine's steady clock, ns, which threads and operators live by.
  [[nodiscard]] virtual std::int64_t MachineNs() const noexcept = 0;

  [[nodiscard]] virtual bool lock_step() const noexcept { return false; }
  /// In lock-step: everything that was sent is done and at rest.
  [[nodiscard]] virtual Finding Rest() noexcept { return {}; }
};

/// An arm, which sends set-points while armed and holds otherwise.
class Manipulator {
 public:
  virtual ~Manipulator() = default;

  /// Once a period: takes what was measured, sends the next set-point. Returns what makes an armed
  /// arm hold, or what now keeps it from being armed.
  [[nodiscard]] virtual Finding Tick(std::int64_t steady_ns, std::int64_t wall_ns) noexcept = 0;
  /// What the last Tick() found is only that the arm is not powered or not homed, which Home()
  /// mends.
  [[nodiscard]] virtual bool needs_homing() const noexcept = 0;
  /// Starts to power up and home the arm, which moves it, or says what is against it.
  [[nodiscard]] virtual Finding Home() noexcept = 0;
  /// Home() is under way.
  [[nodiscard]] virtual bool homing() const noexcept = 0;
  /// Starts sending set-points, the present one at first, or says what is against it.
  [[nodiscard]] virtual Finding Arm() noexcept = 0;
  /// Stops sending, and ends homing, with the next Tick(). Always works.
  virtual void Hold() noexcept = 0;
  /// Starts a motion to `joints` (in the units of the arm) that takes `duration_s`, or says what is
  /// against it.
  [[nodiscard]] virtual Finding MoveTo(std::span<const double> joints,
                                       double duration_s) noexcept = 0;
  [[nodiscard]] virtual bool armed() const noexcept = 0;
  /// A motion is under way.
  [[nodiscard]] virtual bool moving() const noexcept = 0;
  /// No motion is under way, and what is measured has come to rest at the set-point.
  [[nodiscard]] virtual bool at_rest() const noexcept = 0;
};

/// Where states come from.
class Camera {
 public:
  enum class Answer {
    kPending,  ///< Not there yet.
    kNotSeen,  ///< The picture does not show the state, which is NaN.
    kSeen,
  };
  virtual ~Camera() = default;

  /// What its thread thinks of the pictures.
  [[nodiscard]] virtual ThreadFinding Report() noexcept = 0;
  /// Asks for the state in the first picture stamped `after_ns` (ns since the Unix epoch) or later.
  /// Replaces a question that was not answered.
  [[nodiscard]] virtual Finding Ask(std::int64_t after_ns) noexcept = 0;
  /// Writes the state unless it is pending.
  [[nodiscard]] virtual Answer Take(std::span<double> state) noexcept = 0;
};

/// Listens to an emergency stop, and tells the operator's programs how the loop fares.
class EmergencyStop {
 public:
  virtual ~EmergencyStop() = default;

  [[nodiscard]] virtual ThreadFinding Report() noexcept = 0;
  /// Once a period: the loop is alive, and this is its state.
  virtual void Beat(runtime::RunState state) noexcept = 0;
  /// The operator knows that it was pressed.
  virtual void Acknowledge() noexcept = 0;
};

/// Moves the target. It rests unless it was told to move, and comes to rest when told to.
class Platform {
 public:
  virtual ~Platform() = default;

  /// Once a period: whether it can still be told anything.
  [[nodiscard]] virtual Finding Check() noexcept = 0;
  /// Starts on its way home, or says what is against it.
  [[nodiscard]] virtual Finding Home() noexcept = 0;
  /// Its motion begins, and goes on until Rest(). Or says what is against it.
  [[nodiscard]] virtual Finding Begin() noexcept = 0;
  /// Once a period in which the robot may not move: it comes to rest, by the shortest way to a
  /// place that is known. Nothing to do if it rests. Says so where it cannot be told.
  [[nodiscard]] virtual Finding Rest() noexcept = 0;
};

/// Keeps the transitions of a run.
class Recorder {
 public:
  virtual ~Recorder() = default;

  virtual void Write(const runtime::Transition& transition, std::int64_t wall_ns) noexcept = 0;
  /// Once a period: what arm and emergency stop were found to be, and the loop's state.
  virtual void Period(const Finding& /*arm*/, const Finding& /*stop*/, runtime::RunState /*state*/,
                      std::int64_t /*wall_ns*/) noexcept {}
  /// Nothing more can be written.
  [[nodiscard]] virtual bool failed() const noexcept = 0;
};

/// How a control is carried out.
struct Motion {
  std::span<const double> joints;  ///< Where the arm goes. Valid until the next Plan().
  double duration_s = 0.0;
  std::span<const double> change;  ///< By how much the first entries of the state should change.
};

/// What controls mean.
class Task {
 public:
  virtual ~Task() = default;

  [[nodiscard]] virtual int state_dim() const noexcept = 0;
  [[nodiscard]] virtual int control_dim() const noexcept = 0;
  /// The arm was armed: motions begin where it is.
  virtual void Begin() noexcept = 0;
  /// The motion of `control` (control_dim() finite entries), from where the last one ended. Nothing
  /// if the arm cannot reach it.
  [[nodiscard]] virtual std::optional<Motion> Plan(std::span<const double> control) noexcept = 0;
};

}  // namespace dfr::robot
