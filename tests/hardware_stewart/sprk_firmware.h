#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <string_view>
#include <vector>

#include "dfr/kinematics/sprk_platform.h"

namespace dfr::test {

/// The platform's firmware, including its bugs: it treats the available bytes as the whole frame (a
/// missing byte reads as -1), checks no range, saturates silently at the end of the mechanism's
/// reach, turns pitch and yaw left-handed, and multiplies the sine's frequencies by 2 pi but not
/// the breath's.
class SprkFirmware {
 public:
  struct Command {
    char letter = 0;
    /// Values as decoded by the firmware: inches and degrees, with the firmware's signs.
    Eigen::Matrix<double, 6, 1> values = Eigen::Matrix<double, 6, 1>::Zero();
    Eigen::Matrix<double, 6, 1> rad_per_s = Eigen::Matrix<double, 6, 1>::Zero();
    bool whole = true;       ///< True if all of its bytes arrived.
    bool saturated = false;  ///< True if the motion reaches the end of the mechanism.

    /// Entry values in m and rad, right-handed.
    [[nodiscard]] kinematics::PlatformPose Pose() const;
    /// Position of the platform `time_s` after the command: at the pose, or on the wave.
    [[nodiscard]] kinematics::PlatformPose PoseAt(double time_s) const;
  };

  /// Receives bytes that arrive together.
  void Receive(std::string_view bytes);
  [[nodiscard]] const std::vector<Command>& commands() const noexcept { return commands_; }

 private:
  std::vector<Command> commands_;
};

}  // namespace dfr::test
