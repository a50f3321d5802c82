#pragma once

#include <cstdint>

#include "dfr/hardware/psm_client.h"
#include "dfr/sim/dvrk/psm_console.h"

namespace dfr::test {

/// Reads a simulated console as a driver reads its topics.
class ConsoleTopics {
 public:
  /// Reads the state if it has changed since the last call.
  void ReadState(const sim::PsmConsole& console, hardware::PsmInput& input) {
    const bool moves = console.moves_begun() != moves_;
    if (read_ && !moves && console.busy() == state_.busy && console.homed() == state_.homed &&
        StateOf(console) == state_.state) {
      return;
    }
    read_ = true;
    moves_ = console.moves_begun();
    state_.busy = console.busy() || moves;
    state_.homed = console.homed();
    state_.state = StateOf(console);
    if (const hardware::PsmStatus now = hardware::Readiness(state_);
        now != hardware::PsmStatus::kOk) {
      ++state_.lapses;
      state_.last_lapse = now;
    }
    input.operating_state = state_;
  }

  /// Reads all measurements and set-points.
  static void Measure(const sim::PsmConsole& console, std::int64_t wall_ns,
                      hardware::PsmInput& input) {
    hardware::PsmJointSample sample;
    if (console.valid()) sample.stamp = dds::Stamp::FromNanoseconds(wall_ns);
    sample.well_formed = sample.has_velocity = true;
    sample.position = console.measured_joints();
    sample.velocity = console.joint_velocity();
    input.measured_js = sample;
    sample.position = console.setpoint_joints();
    input.setpoint_js = sample;
    const Eigen::Isometry3d pose = console.measured_pose();
    input.measured_cp = {sample.stamp, pose.translation(), Eigen::Quaterniond(pose.linear())};
    input.jaw_measured = {sample.stamp, console.measured_jaw()};
    input.jaw_setpoint = {sample.stamp, console.setpoint_jaw()};
  }

 private:
  static hardware::PsmConsoleState StateOf(const sim::PsmConsole& console) {
    switch (console.state()) {
      case sim::ArmState::kDisabled:
        return hardware::PsmConsoleState::kDisabled;
      case sim::ArmState::kEnabled:
        return hardware::PsmConsoleState::kEnabled;
      case sim::ArmState::kPaused:
        return hardware::PsmConsoleState::kPaused;
      case sim::ArmState::kFault:
        break;
    }
    return hardware::PsmConsoleState::kFault;
  }

  hardware::PsmOperatingState state_;
  bool read_ = false;
  int moves_ = 0;
};

}  // namespace dfr::test
