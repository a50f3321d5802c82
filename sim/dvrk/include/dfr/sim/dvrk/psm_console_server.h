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
  double delay_s = 0.0;        ///< What is published about motion arrives that late, in [0, 2].
  double jitter_s = 0.0;       ///< Up to so much later still, uniformly, in order; in [0, 2].
  double drop = 0.0;           ///< Share of the state samples that are lost, in [0, 1].
  double drop_commands = 0.0;  ///< Share of the motion commands that are lost, in [0, 1].
  double clock_jump_s = 0.0;   ///< Added to all stamps but zero ones, in [-1e6, 1e6].
  bool freeze = false;         ///< The same state is published again and again, stamp included.
  bool silent = false;         ///< No state is published.
  bool invalid = false;        ///< Everything is stamped zero.
  bool corrupt = false;        ///< Positions and velocities are NaN.
};

/// Sets one of the above by name: delay, jitter, drop, drop_commands, clock_jump, freeze, silent,
/// invalid, corrupt. `value` is a number; of a flag 0 or 1.
/// @returns false if no fault has this name.
/// @throws std::invalid_argument naming the fault, if `value` is not such a number.
[[nodiscard]] bool SetFault(ConsoleFaults& faults, std::string_view name, std::string_view value);

/// Options for PsmConsoleServer.
struct PsmConsoleServerOptions {
  double state_period_s = 0.01;  ///< From one published state to the next, > 0.
  std::uint64_t seed = 1;        ///< Seeds what is lost, and ConsoleFaults::jitter_s.
  /// Gives the time for stamps.
  std::function<dds::Stamp()> clock = &dds::Stamp::Now;
};

/// A PsmConsole on the topics and services of a real one, below its arm's name (CRTK convention
/// over ROS 2; all that dvrk_python's psm asks for, and jhu-dvrk's contract for simulators):
///   publishes  measured_js setpoint_js measured_cp setpoint_cp local/measured_cp local/setpoint_cp
///              measured_cv jaw/measured_js jaw/setpoint_js body/ and spatial/ measured_cf jacobian
///              operating_state state goal_reached error warning status info tool_type
///              trajectory_j/ratio
///   takes      state_command servo_cp servo_cs servo_cr servo_jp servo_jr servo_jf move_cp move_jp
///              move_jr hold free jaw/servo_jp jaw/servo_jf jaw/move_jp body/ and spatial/ servo_cf
///              trajectory_j/set_ratio, and without effect use_gravity_compensation
///              body/set_cf_orientation_absolute emulate_tool_present
///   answers    forward_kinematics local/forward_kinematics inverse_kinematics
/// While the arm is not homed, measurements are stamped zero, as a console marks invalid data. The
/// operating state is published when it changes, when a move begins, and once a second. Forces are
/// zero; of servo_cs the pose is taken. local/ is relative to the arm's own base.
///
/// It has no thread: Tick() is its loop, and time is what the caller says it is. One object belongs
/// to one thread at a time.
class PsmConsoleServer {
 public:
  /// Borrows both, which must outlive it.
  /// @throws std::invalid_argument naming the option that is out of range; std::runtime_error if
  ///   DDS refuses a topic.
  PsmConsoleServer(dds::Participant& participant, PsmConsole& console,
                   const PsmConsoleServerOptions& options = {});
  ~PsmConsoleServer();
  PsmConsoleServer(const PsmConsoleServer&) = delete;
  PsmConsoleServer& operator=(const PsmConsoleServer&) = delete;

  /// Takes all commands that have come, steps the console by `dt_s`, and publishes what is due.
  void Tick(double dt_s);
  /// The two ends of Tick(), for callers that step the console themselves. Publish() is told how
  /// much time has passed, and publishes the state also when it is not due if `now`.
  void TakeCommands();
  void Publish(double dt_s, bool now);
  /// Publishes what the console has said, and the operating state if it has changed.
  void PublishEvents();

  /// Motion commands taken since the start, those that the console dropped included.
  [[nodiscard]] std::uint64_t commands_taken() const noexcept;
  /// States published since the start.
  [[nodiscard]] std::uint64_t states_published() const noexcept;

  /// What is late on its way is lost.
  /// @throws std::invalid_argument naming the fault that is out of range.
  void SetFaults(const ConsoleFaults& faults);
  [[nodiscard]] const ConsoleFaults& faults() const noexcept;
  /// What time a stamp says it is: options' clock and ConsoleFaults::clock_jump_s.
  [[nodiscard]] dds::Stamp now() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::sim
