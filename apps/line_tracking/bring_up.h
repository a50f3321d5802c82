#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/dds/participant.h"
#include "dfr/robot/control_loop.h"

namespace dfr::apps::line_tracking {

/// Tells the operator something; may be empty.
using Say = std::function<void(std::string_view)>;
/// Asks the operator a question, and goes on with the loop until exactly `word` is typed, or false;
/// where it is empty, the operator says no to everything.
using Confirms = std::function<bool(std::string_view question, std::string_view word)>;

/// In whose presence the robot may move: of those who were there before, and whom the operator was
/// told of.
class Company {
 public:
  /// Tells of those of the `present` that were not accepted before, and asks whether to go on in
  /// their presence. A simulation's are not asked about.
  [[nodiscard]] bool Accepts(const std::vector<dds::Newcomer>& present, bool simulated,
                             const Say& say, const Confirms& confirms);
  /// Whether all of them were accepted.
  [[nodiscard]] bool Knows(const std::vector<dds::Newcomer>& present) const;

 private:
  std::vector<dds::Origin> accepted_;
};

/// A robot that is to be brought up. What it points to outlives the call.
struct BringUpOptions {
  robot::ControlLoop* loop = nullptr;
  const robot::Manipulator* arm = nullptr;
  std::string name = "PSM1";  ///< The arm's.
  /// It is homed without being asked.
  bool simulated = false;
  /// It is homed already, by the simulator.
  bool homed = false;
  /// How long the platform takes home, s; 0: there is none.
  double platform_home_s = 0.0;
  /// Whether the operator accepts all those who can tell the arm to hold, to be free or to change
  /// its state; may be empty.
  std::function<bool()> accepts_others = {};
  double patience_s = 10.0;  ///< The devices may be found one after the other.
  /// What else is known of why the robot is not ready; may be empty.
  std::function<std::string()> remedy = {};
};

/// Waits until the robot can be started. An arm that is not homed is powered up and homed once the
/// operator says so, and has accepted who else is there; a simulated one without being asked. Then
/// the platform goes home, if there is one, on a word of its own. Nothing is sent before these
/// words, nor while the emergency stop is pressed or not heard of.
/// @throws std::runtime_error with what is wrong.
void BringUp(const BringUpOptions& robot, const Say& say, const Confirms& confirms);

}  // namespace dfr::apps::line_tracking
