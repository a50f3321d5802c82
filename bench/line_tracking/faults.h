#pragma once

#include <functional>
#include <string>
#include <vector>

#include "robot_site.h"

namespace dfr::apps::line_tracking {

struct Fault {
  std::string name;
  std::function<void(Site&)> begin;
  std::function<void(Site&)> end;
  bool blind = false;        ///< The simulator is stopped and cannot be queried during the fault.
  bool to_operator = false;  ///< The robot's program fails; detected on the operator's screen.
  bool wire = false;         ///< Between two hosts, if the system permits them.
  bool harmless = false;     ///< Must have no effect: passes if the run continues.
  bool homing = false;       ///< During homing, which the fault must end.
  bool ends = false;         ///< Ends a program, or needs a different site from a soak's.
  bool platform = false;     ///< At the platform's port; other faults run without a platform.
};

/// All faults, in the order of the table.
[[nodiscard]] std::vector<Fault> Faults();

}  // namespace dfr::apps::line_tracking
