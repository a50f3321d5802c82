#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <span>

namespace dfr::vision::internal {

/// One mark: where it is on its target, and where the camera saw it.
struct MarkSighting {
  Eigen::Vector3d on_target;   ///< m
  Eigen::Vector2d normalized;  ///< (x/z, y/z)
};

/// Pose of a target by Gauss-Newton on the reprojection error, from a first guess; at least four
/// sightings that are not on one line. Returns the root mean square error in normalised units,
/// +infinity if it did not converge.
[[nodiscard]] double RefinePose(std::span<const MarkSighting> sightings,
                                Eigen::Isometry3d& p_cam_target) noexcept;

}  // namespace dfr::vision::internal
