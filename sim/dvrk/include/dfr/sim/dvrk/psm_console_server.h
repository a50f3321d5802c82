#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string_view>

#include "dfr/dds/messages.h"
#include "dfr/dds/participant.h"
#include "dfr/sim/dvrk/psm_console.h"

namespace dfr::sim {

/// Faults between the console and its clients, for tests.
struct ConsoleFaults {
  double delay_s = 0.0;        ///< Delay of published states, in [0, 2].
  double jitter_s = 0.0;       ///< Maximum random additional delay, in [0, 2]. Keeps the order.
  double drop = 0.0;           ///< Fraction of state samples lost, in [0, 1].
  double drop_commands = 0.0;  ///< Fraction of motion commands lost, in [0, 1].
  double clock_jump_s = 0.0;   ///< Added to all timestamps except zero ones, in [-1e6, 1e6].
  bool freeze = false;         ///< Publishes the same state repeatedly, timestamp included.
  bool silent = false;         ///< Publishes no state.
  bool invalid = false;        ///< Sets all timestamps to zero.
  bool corrupt = false;        ///< Sets positions and velocities to NaN.
};

/// Sets a fault by name: delay, jitter, drop, drop_commands, clock_jump, freeze, silent, invalid,
/// corrupt. `value` is a number; 0 or 1 for a flag.
/// @returns false if no fault has this name.
/// @throws std::invalid_argument naming the fault, if `value` is not such a number.
[[nodiscard]] bool SetFault(ConsoleFaults& faults, std::string_view name, std::string_view value);

/// Options for PsmConsoleServer.
struct PsmConsoleServerOptions {
  double state_period_s = 0.01;  ///< Period of published states, > 0.
  std::uint64_t seed = 1;        ///< Seeds losses and ConsoleFaults::jitter_s.
  /// Clock for timestamps.
  std::function<dds::Stamp()> clock = &dds::Stamp::Now;
};

/// Publishes a PsmConsole on the topics and services of a real one, under its arm's name. Follows
/// the CRTK convention over ROS 2. Offers everything that dvrk_python's psm requires, and fulfils
/// jhu-dvrk's contract for simulators.
///   publishes  measured_js setpoint_js measured_cp setpoint_cp local/measured_cp local/setpoint_cp
///              measured_cv jaw/measured_js jaw/setpoint_js body/ and spatial/ measured_cf jacobian
///              operating_state state goal_reached error warning status info tool_type
///              trajectory_j/ratio
///   takes      state_command servo_cp servo_cs servo_cr servo_jp servo_jr servo_jf move_cp move_jp
///              move_jr hold free jaw/servo_jp jaw/servo_jf jaw/move_jp body/ and spatial/ servo_cf
///              trajectory_j/set_ratio, and without effect use_gravity_compensation
///              body/set_cf_orientation_absolute emulate_tool_present
///   answers    forward_kinematics local/forward_kinematics inverse_kinematics
/// Until the arm is homed, measurements have the timestamp zero, a console's mark of invalid data.
/// The operating state is published when it changes, when a move starts, and once a second. Forces
/// are zero. Only the pose of servo_cs is used. local/ is relative to the arm's own base.
///
/// The server has no thread: the caller calls Tick() in a loop and provides the time. Each object
/// belongs to one thread at a time.
class PsmConsoleServer {
 public:
  /// Borrows participant and console, which must outlive the server.
  /// @throws std::invalid_argument naming the option out of range; std::runtime_error if DDS
  ///   refuses a topic.
  PsmConsoleServer(dds::Participant& participant, PsmConsole& console,
                   const PsmConsoleServerOptions& options = {});
  ~PsmConsoleServer();
  PsmConsoleServer(const PsmConsoleServer&) = delete;
  PsmConsoleServer& operator=(const PsmConsoleServer&) = delete;

  /// Takes all pending commands, steps the console by `dt_s`, and publishes all due messages.
  void Tick(double dt_s);
  /// The two parts of Tick(), for callers that step the console themselves. Publish() takes the
  /// elapsed time. If `now` is set, it publishes the state even if it is not due.
  void TakeCommands();
  void Publish(double dt_s, bool now);
  /// Publishes the console's messages and, if it changed, the operating state.
  void PublishEvents();

  /// Waits until the subscribers have received all published messages about events: status,
  /// warning, error and operating_state. Waits at most `timeout_s` for each topic.
  /// @returns false on a timeout.
  bool WaitUntilReceived(double timeout_s) noexcept;
  /// Number of subscribers to status.
  [[nodiscard]] int status_subscribers() const noexcept;

  /// Number of motion commands taken since the start, including those that the console dropped.
  [[nodiscard]] std::uint64_t commands_taken() const noexcept;
  /// Number of states published since the start.
  [[nodiscard]] std::uint64_t states_published() const noexcept;

  /// Sets the faults. Delayed messages still in transit are lost.
  /// @throws std::invalid_argument naming the fault out of range.
  void SetFaults(const ConsoleFaults& faults);
  [[nodiscard]] const ConsoleFaults& faults() const noexcept;
  /// Timestamp source: the configured clock plus ConsoleFaults::clock_jump_s.
  [[nodiscard]] dds::Stamp now() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::sim
