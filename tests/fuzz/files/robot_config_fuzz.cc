// Configurations of line tracking, in TOML.
#include <stdexcept>

#include "apps/line_tracking/robot/robot_config.h"
#include "tests/fuzz/input_file.h"
#include "tests/fuzz/target.h"

DFR_FUZZ_TARGET(robot_config) {
  try {
    static_cast<void>(dfr::apps::line_tracking::RobotConfig::Load(
        dfr::fuzz::InputFile(dfr::fuzz::AsText(data, size))));
  } catch (const std::runtime_error&) {  // NOLINT(bugprone-empty-catch): expected for bad input
  }
  return 0;
}
