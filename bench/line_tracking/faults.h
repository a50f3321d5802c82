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
  bool blind = false;  ///< The simulator is stopped and cannot be queried during the fault.
  /// The robot's program fails, which is detected on the operator's screen.
  bool to_operator = false;
  bool wire = false;  ///< The fault is between two hosts, if the system permits them.
  /// The fault must have no effect: the test passes if the run continues.
  bool harmless = false;
  bool homing = false;  ///< The fault occurs during homing, which it must end.
  bool ends = false;    ///< The fault ends a program, or needs a site that a soak lacks.
  /// The fault is at the platform's port. Other faults run without a platform.
  bool platform = false;
};

/// All faults, in the order of the table.
[[nodiscard]] std::vector<Fault> Faults();

}  // namespace dfr::apps::line_tracking
