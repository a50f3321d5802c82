#include "robot_watch.h"

#include <algorithm>
#include <ostream>

#include "dfr/core/text/format.h"
#include "dfr/dds/emergency_stop.h"

namespace dfr::apps::hardware_app {

void RobotWatch::Hear(const dds::Origin& who, const std::string& state, std::int64_t steady_ns) {
  Robot* robot = Find(who);
  if (robot == nullptr) return;
  robot->heard_ns = steady_ns;
  if (robot->gone || state != robot->state) Say(Name(*robot) + ": " + state, steady_ns);
  robot->gone = state == dds::kRunEnded;  // an ended program is not reported as missing
  robot->state = state;
}

void RobotWatch::Say(const std::string& text, std::int64_t steady_ns) {
  constexpr std::size_t kMostCharacters = 80;
  if (!limit_.Passes(steady_ns)) return;
  std::string shown = text.substr(0, kMostCharacters);
  core::MakePrintable(shown);
  *out_ << shown << std::endl;
}

void RobotWatch::Look(std::int64_t steady_ns) {
  if (const std::uint64_t left_out = limit_.TakeLeftOut(steady_ns); left_out > 0) {
    *out_ << "robots: " << left_out << " more changes are not shown" << std::endl;
  }
  constexpr std::int64_t kSilence = 150'000'000;  // ns
  for (Robot& robot : robots_) {
    if (robot.gone || steady_ns - robot.heard_ns <= kSilence) continue;
    robot.gone = true;
    std::string state = robot.state.substr(0, 32);
    core::MakePrintable(state);
    *out_ << Name(robot) << ": SILENT while " << state
          << ". Its program hangs, was killed or cannot be heard: the robot may move, watch it"
          << std::endl;
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
