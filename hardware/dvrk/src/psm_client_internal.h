#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>

#include "dfr/hardware/psm_client.h"

namespace dfr::hardware::internal {

inline constexpr double kCommandTime = 0.15;  // s, maximum time from sending to execution

[[nodiscard]] inline double Seconds(std::int64_t ns) noexcept {
  return 1e-9 * static_cast<double>(ns);
}

// Returns joints with `value` as the first entry, for a PsmRecentSetpoints of a single value.
[[nodiscard]] inline kinematics::PsmJoints InFirstPlace(double value) noexcept {
  kinematics::PsmJoints joints = kinematics::PsmJoints::Zero();
  joints[0] = value;
  return joints;
}

[[nodiscard]] inline Eigen::Isometry3d Transform(const PsmPoseSample& pose) noexcept {
  Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
  transform.translation() = pose.position_m;
  transform.linear() = pose.orientation.normalized().toRotationMatrix();
  return transform;
}

[[nodiscard]] inline bool Finite(const PsmPoseSample& pose) noexcept {
  // A quaternion that is not of unit length is not an orientation.
  constexpr double kRounding = 1e-3;
  return pose.position_m.allFinite() && std::abs(pose.orientation.norm() - 1.0) <= kRounding;
}

}  // namespace dfr::hardware::internal
