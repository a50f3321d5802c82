#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <span>

namespace dfr::vision::internal {

/// One mark: its position on the target, and its observed position in the image.
struct MarkSighting {
  Eigen::Vector3d on_target;   ///< m
  Eigen::Vector2d normalized;  ///< (x/z, y/z)
};

/// Estimates the pose of a target by Gauss-Newton on the reprojection error, from an initial guess.
/// Requires at least four sightings that are not collinear. Returns the root mean square error in
/// normalised units, or +infinity without convergence.
[[nodiscard]] double RefinePose(std::span<const MarkSighting> sightings,
                                Eigen::Isometry3d& p_cam_target) noexcept;

}  // namespace dfr::vision::internal
