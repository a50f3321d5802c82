#pragma once

#include <string_view>

namespace dfr::hardware {

/// Kind of the commands that control an arm.
enum class PsmControl {
  kUnstated,  ///< The text states no control.
  kNone,      ///< No commands: the arm is being homed, or is not ENABLED.
  kPoses,     ///< servo_cp and servo_cs.
  kOther,     ///< All other commands, including hold and free.
};

/// Returns the control stated by a text on the console's topic `status`. A console of dVRK 2.2 to
/// 2.4 reports each change of control space and mode: a hold after servo_cp gives "PSM1: control
/// JOINT_SPACE/POSITION_MODE", and the next servo_cp gives "PSM1: control
/// CARTESIAN_SPACE/POSITION_MODE".
/// Never allocates.
[[nodiscard]] PsmControl ControlStatedBy(std::string_view text) noexcept;

}  // namespace dfr::hardware
