#include "dfr/hardware/bring_up.h"

#include <algorithm>
#include <stdexcept>

namespace dfr::hardware {
namespace {

using runtime::HoldReason;

std::runtime_error NotReady(const BringUpOptions& robot) {
  return std::runtime_error("the robot is not ready: " + robot.loop->blocking_words() +
                            (robot.remedy ? robot.remedy() : ""));
}

// Waits until nothing blocks homing. After a press or a silence of the emergency stop the operator
// must type `clear`. A simulated robot goes on after a silence.
void AwaitHomeable(const BringUpOptions& robot, const Say& say, const Confirms& confirms) {
  robot::ControlLoop& loop = *robot.loop;
  while (!loop.AwaitHomeable(robot.patience_s, say)) {
    const bool pressed = loop.stop_pressed();
    const bool silent = loop.stop_silence_s() > 0.0;
    const bool stopped = pressed || silent || loop.blocking() == HoldReason::kEmergencyStop ||
                         loop.blocking() == HoldReason::kEmergencyStopSilent;
    if (robot.simulated && silent && !pressed) {
      static_cast<void>(loop.Clear());
      if (loop.stop_silence_s() == 0.0) continue;
    }
    if (!stopped || !confirms ||
        !confirms(loop.blocking_words() + ". Correct it, then type clear", "clear")) {
      throw NotReady(robot);
    }
    // The operator does not know of a press or a silence during the question.
    if ((loop.stop_pressed() && !pressed) || (loop.stop_silence_s() > 0.0 && !silent)) continue;
    static_cast<void>(loop.Clear());
  }
}

void AcceptOthers(const BringUpOptions& robot) {
  if (!robot.accepts_others || robot.accepts_others()) return;
  throw std::runtime_error("other participants can command " + robot.name +
                           ", and the operator did not accept them");
}

void BringUpArm(const BringUpOptions& robot, const Say& say, const Confirms& confirms) {
  robot::ControlLoop& loop = *robot.loop;
  AwaitHomeable(robot, say, confirms);
  AcceptOthers(robot);
  if (!robot.arm->needs_homing()) return;
  const auto holds_good = [&] {
    return loop.AwaitHomeable(0.0, {}) && (!robot.knows_others || robot.knows_others());
  };
  // A doubt or a participant that arises during the question voids the answer.
  for (bool confirmed = robot.simulated; !confirmed; confirmed = holds_good()) {
    AwaitHomeable(robot, say, confirms);
    AcceptOthers(robot);
    if (!(confirms && confirms(robot.name + " is not homed. If it is clear of people and objects, "
                                            "type home: it is powered up and moves",
                               "home"))) {
      throw std::runtime_error(robot.name +
                               " is not homed, and the operator did not confirm homing");
    }
  }
  if (say) say(robot.name + ": homing");
  if (loop.Home() != HoldReason::kNone) {
    throw std::runtime_error(robot.name + " was not homed: " + loop.blocking_words());
  }
}

}  // namespace

bool Company::Knows(const std::vector<dds::Newcomer>& present) const {
  return std::ranges::all_of(present, [this](const dds::Newcomer& other) {
    return std::ranges::find(accepted_, other.origin) != accepted_.end();
  });
}

bool Company::Accepts(const std::vector<dds::Newcomer>& present, bool simulated, const Say& say,
                      const Confirms& confirms) {
  if (Knows(present)) return true;
  for (const dds::Newcomer& other : present) {
    if (say && !Knows({other})) say("also present: " + dds::Describe(other));
  }
  if (!simulated && !(confirms && confirms("They can hold or free the arm, or change its state or "
                                           "settings. To continue in their presence, type together",
                                           "together"))) {
    return false;
  }
  accepted_.clear();
  for (const dds::Newcomer& other : present) accepted_.push_back(other.origin);
  return true;
}

void BringUp(const BringUpOptions& robot, const Say& say, const Confirms& confirms) {
  if (!robot.homed) BringUpArm(robot, say, confirms);
  if (!robot.loop->AwaitReady(robot.patience_s, say)) throw NotReady(robot);
  if (robot.platform_home_s == 0.0) return;
  if (!(confirms &&
        confirms("the platform will move to its home position, and only cutting its power "
                 "stops it on the way. If nothing touches the gauze, type platform",
                 "platform"))) {
    throw std::runtime_error(
        "the platform is not at home, and the operator did not confirm homing");
  }
  if (robot.loop->HomePlatform(robot.platform_home_s) != HoldReason::kNone) {
    throw std::runtime_error("the platform was not homed: " + robot.loop->blocking_words() +
                             "; if it moves, only cutting its power stops it before it is at home");
  }
}

}  // namespace dfr::hardware
