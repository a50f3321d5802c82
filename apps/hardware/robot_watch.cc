#include "robot_watch.h"

#include <algorithm>
#include <ostream>

#include "dfr/dds/emergency_stop.h"

namespace dfr::apps::hardware_app {

void RobotWatch::Hear(const dds::Origin& who, const std::string& state, std::int64_t steady_ns) {
  Robot* robot = Find(who);
  if (robot == nullptr) return;
  robot->heard_ns = steady_ns;
  if (robot->gone || state != robot->state) *out_ << Name(*robot) << ": " << state << std::endl;
  robot->gone = state == dds::kRunEnded;  // and is not missed
  robot->state = state;
}

void RobotWatch::Look(std::int64_t steady_ns) {
  constexpr std::int64_t kSilence = 150'000'000;  // ns
  for (Robot& robot : robots_) {
    if (robot.gone || steady_ns - robot.heard_ns <= kSilence) continue;
    robot.gone = true;
    *out_ << Name(robot) << ": SILENT while " << robot.state
          << ". Its program hangs, was killed or cannot be heard; the arm holds" << std::endl;
  }
}

RobotWatch::Robot* RobotWatch::Find(const dds::Origin& who) {
  const auto known = std::ranges::find(robots_, who, &Robot::who);
  if (known != robots_.end()) return &*known;
  const auto free = std::ranges::find(robots_, true, &Robot::gone);
  if (free == robots_.end()) return nullptr;
  *free = {.who = who, .state = {}, .heard_ns = 0, .gone = true};
  return &*free;
}

std::string RobotWatch::Name(const Robot& robot) const {
  const auto number = &robot - robots_.data() + 1;
  return number == 1 ? "robot" : "robot " + std::to_string(number);
}

}  // namespace dfr::apps::hardware_app
