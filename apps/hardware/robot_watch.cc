#include "robot_watch.h"

#include <algorithm>
#include <ostream>

#include "dfr/dds/emergency_stop.h"

namespace dfr::apps::hardware_app {

RobotWatch::RobotWatch(dds::Participant& participant, std::ostream& out)
    : subscriber_(participant, dds::kRunStateTopic, dds::Role::kRequest), out_(&out) {}

void RobotWatch::Show() {
  constexpr std::chrono::milliseconds kSilence{150};
  const auto now = Clock::now();
  dds::OperatingState message;
  dds::Origin who;
  while (subscriber_.Take(message, who)) {
    Robot* robot = Find(who);
    if (robot == nullptr) continue;
    robot->heard = now;
    if (robot->gone || message.state != robot->state) {
      *out_ << Name(*robot) << ": " << message.state << std::endl;
    }
    robot->gone = message.state == dds::kRunEnded;  // and is not missed
    robot->state = message.state;
  }
  for (Robot& robot : robots_) {
    if (robot.gone || now - robot.heard <= kSilence) continue;
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
  *free = {.who = who, .state = {}, .heard = {}, .gone = true};
  return &*free;
}

std::string RobotWatch::Name(const Robot& robot) const {
  const auto number = &robot - robots_.data() + 1;
  return number == 1 ? "robot" : "robot " + std::to_string(number);
}

}  // namespace dfr::apps::hardware_app
