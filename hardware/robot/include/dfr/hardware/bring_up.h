#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/dds/participant.h"
#include "dfr/robot/control_loop.h"

namespace dfr::hardware {

/// Prints a text for the operator; may be empty.
using Say = std::function<void(std::string_view)>;
/// Asks the operator a question while the loop continues. Returns true once the operator types
/// exactly `word`, false if the operator declines. If empty, all answers are no.
using Confirms = std::function<bool(std::string_view question, std::string_view word)>;

/// Listed participants that the operator has accepted. The robot may move in their presence.
class Company {
 public:
  /// Lists the participants in `present` that are not accepted yet, and asks whether to continue in
  /// their presence. Does not ask in a simulation.
  [[nodiscard]] bool Accepts(const std::vector<dds::Newcomer>& present, bool simulated,
                             const Say& say, const Confirms& confirms);
  /// Returns true if all participants in `present` are accepted.
  [[nodiscard]] bool Knows(const std::vector<dds::Newcomer>& present) const;

 private:
  std::vector<dds::Origin> accepted_;
};

/// A robot to bring up. The pointers must stay valid during the call.
struct BringUpOptions {
  robot::ControlLoop* loop = nullptr;
  const robot::Manipulator* arm = nullptr;
  std::string name = "PSM1";  ///< Name of the arm.
  /// True if the arm is homed without asking the operator.
  bool simulated = false;
  /// True if the simulator has already homed the arm.
  bool homed = false;
  /// Time that the platform needs to go home, s; 0: no platform.
  double platform_home_s = 0.0;
  /// Asks whether the operator accepts all participants that can hold or free the arm or change its
  /// state; may be empty.
  std::function<bool()> accepts_others = {};
  /// Returns true if no such participant has joined since `accepts_others`; may be empty.
  std::function<bool()> knows_others = {};
  double patience_s = 10.0;  ///< Time to wait for the devices.
  /// Further reasons why the robot is not ready; may be empty.
  std::function<std::string()> remedy = {};
};

/// Waits until the robot can start. Powers up and homes an arm that is not homed, after the
/// operator has confirmed it and accepted the other participants; a simulated arm needs no
/// confirmation. Then the platform, if present, goes home after a separate confirmation. Nothing is
/// sent before these confirmations, or while the emergency stop is pressed or silent.
/// @throws std::runtime_error with the reason.
void BringUp(const BringUpOptions& robot, const Say& say, const Confirms& confirms);

}  // namespace dfr::hardware
