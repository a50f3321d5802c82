#pragma once

#include <functional>
#include <string_view>

#include "robot/robot_config.h"

namespace dfr::apps::line_tracking {

/// Returns the configuration of a run on dvrk_simulator --lock-step that waits a day for answers.
inline RobotConfig LockStepConfig(int domain) {
  RobotConfig config;
  config.robot = RobotPlace::kDds;
  config.network.domain = domain;
  config.simulator = true;
  config.lock_step = true;
  config.simulator_answer_s = 86400.0;
  config.emergency_stop = false;
  return config;
}

/// Confirms ten questions and refuses further ones, which ends an endless repetition.
inline std::function<bool(std::string_view, std::string_view)> Agrees() {
  return [left = 10](std::string_view, std::string_view) mutable { return left-- > 0; };
}

}  // namespace dfr::apps::line_tracking
