#pragma once

#include <string_view>

namespace dfr::hardware {

/// The commands that control an arm.
enum class PsmControl {
  kUnstated,  ///< The text states none.
  kNone,      ///< No commands: the arm is being homed, or is not ENABLED.
  kPoses,     ///< servo_cp and servo_cs.
  kOther,     ///< All others. hold and free change the control, too.
};

/// Returns the control that a text of the console's topic `status` states. A console of dVRK 2.2 to
/// 2.4 states each change of control space and mode: after servo_cp, a hold gives
/// "PSM1: control JOINT_SPACE/POSITION_MODE", and the next servo_cp
/// "PSM1: control CARTESIAN_SPACE/POSITION_MODE". Never allocates.
[[nodiscard]] PsmControl ControlStatedBy(std::string_view text) noexcept;

}  // namespace dfr::hardware
