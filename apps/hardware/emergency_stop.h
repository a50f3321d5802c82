#pragma once

#include <string_view>

#include "dfr/dds/participant.h"

namespace dfr::apps::hardware_app {

struct EmergencyStopOptions {
  dds::ParticipantOptions network = {.name = "emergency_stop"};
  bool unattended =
      false;  ///< No operator is at the terminal: reports only that the stop is not pressed.
};

/// Meaning of a line typed at an emergency stop.
enum class StopWord { kPress, kRelease, kEnd };
/// Exactly "r" releases the stop, and exactly "q" presses it and quits. Any other line presses it.
[[nodiscard]] StopWord Meaning(std::string_view line) noexcept;

/// Runs an operator's emergency stop in a terminal, until Ctrl-C, q or the end of the input. Also
/// runs without a robot, because a robot may join later. Shows the state of line_tracking, and
/// reports when line_tracking goes silent.
void RunEmergencyStop(const EmergencyStopOptions& options);

}  // namespace dfr::apps::hardware_app
