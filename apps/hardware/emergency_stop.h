#pragma once

#include <string_view>

#include "dfr/dds/participant.h"

namespace dfr::apps::hardware_app {

struct EmergencyStopOptions {
  dds::ParticipantOptions network = {.name = "emergency_stop"};
  bool unattended = false;  ///< Nobody sits at the terminal: it only says that nothing is pressed.
};

/// What a line at the keyboard of an emergency stop means.
enum class StopWord { kPress, kRelease, kEnd };
/// Only exactly "r" releases it, and only exactly "q" ends it, which stops, too.
[[nodiscard]] StopWord Meaning(std::string_view line) noexcept;

/// An operator's emergency stop in a terminal, until Ctrl-C or q: Enter presses it, and so does any
/// line but "r", which releases it.
/// Also where nobody listens, for a robot may join later. Shows what line_tracking is doing, and
/// when nothing is heard of it any more.
void RunEmergencyStop(const EmergencyStopOptions& options);

}  // namespace dfr::apps::hardware_app
