#pragma once

#include <cstdint>
#include <memory>

#include "dfr/dds/participant.h"
#include "dfr/sim/dvrk/psm_console.h"

namespace dfr::sim {

/// What goes wrong between the console and its clients, for tests of what then happens.
struct ConsoleFaults {
  double delay_s = 0.0;  ///< What is published about motion is that old, in [0, 2].
  double drop = 0.0;     ///< Share of the state samples that are lost, in [0, 1].
  bool freeze = false;   ///< The same state is published again and again, stamp included.
  bool silent = false;   ///< No state is published.
  bool invalid = false;  ///< Everything is stamped zero.
  bool corrupt = false;  ///< Positions are NaN.
};

/// Options for PsmConsoleServer.
struct PsmConsoleServerOptions {
  double state_period_s = 0.01;  ///< From one published state to the next, > 0.
  std::uint64_t seed = 1;        ///< Of what ConsoleFaults::drop loses.
};

/// A PsmConsole on the topics of a real one, below its arm's name (CRTK convention over ROS 2):
///   publishes  measured_js setpoint_js measured_cp setpoint_cp jaw/measured_js jaw/setpoint_js
///              operating_state goal_reached error warning status
///   takes      state_command servo_cp servo_jp move_cp move_jp hold jaw/servo_jp jaw/move_jp
/// While the arm is not homed, measurements are stamped zero, as a console marks invalid data. The
/// operating state is published when it changes and once a second.
///
/// It has no thread: Tick() is its loop, and time is what the caller says it is. One object belongs
/// to one thread at a time.
class PsmConsoleServer {
 public:
  /// Borrows both, which must outlive it.
  /// @throws std::invalid_argument naming the option that is out of range; std::runtime_error if
  /// DDS
  ///   refuses a topic.
  PsmConsoleServer(dds::Participant& participant, PsmConsole& console,
                   const PsmConsoleServerOptions& options = {});
  ~PsmConsoleServer();
  PsmConsoleServer(const PsmConsoleServer&) = delete;
  PsmConsoleServer& operator=(const PsmConsoleServer&) = delete;

  /// Takes all commands that have come, steps the console by `dt_s`, and publishes what is due.
  void Tick(double dt_s);

  /// @throws std::invalid_argument naming the fault that is out of range.
  void SetFaults(const ConsoleFaults& faults);
  [[nodiscard]] const ConsoleFaults& faults() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::sim
