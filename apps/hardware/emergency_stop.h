#pragma once

#include "dfr/dds/participant.h"

namespace dfr::apps::hardware_app {

struct EmergencyStopOptions {
  dds::ParticipantOptions network = {.name = "emergency_stop"};
  bool unattended = false;  ///< Nobody sits at the terminal: it only says that nothing is pressed.
};

/// An operator's emergency stop in a terminal, until Ctrl-C or q: Enter presses it, and so does any
/// line but "r", which releases it.
/// Also where nobody listens, for a robot may join later. Shows what line_tracking is doing, and
/// when nothing is heard of it any more.
void RunEmergencyStop(const EmergencyStopOptions& options);

}  // namespace dfr::apps::hardware_app
