#include "plane_pose.h"

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>

namespace dfr::vision::internal {
namespace {

using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;
using Matrix26d = Eigen::Matrix<double, 2, 6>;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

}  // namespace

double RefinePose(std::span<const MarkSighting> sightings,
                  Eigen::Isometry3d& p_cam_target) noexcept {
  if (sightings.size() < 4) return kInfinity;
  for (int iteration = 0; iteration < 15; ++iteration) {
    Matrix6d normal = Matrix6d::Zero();
    Vector6d right = Vector6d::Zero();
    double squared = 0.0;
    for (const MarkSighting& sighting : sightings) {
      const Eigen::Vector3d arm = p_cam_target.linear() * sighting.on_target;
      const Eigen::Vector3d p = arm + p_cam_target.translation();
      if (!(p.z() > 1e-6)) return kInfinity;
      const double inverse = 1.0 / p.z();
      const Eigen::Vector2d seen(p.x() * inverse, p.y() * inverse);
      const Eigen::Vector2d error = seen - sighting.normalized;
      // A translation t moves p by t; a small rotation w moves p by w x arm.
      Eigen::Matrix<double, 2, 3> by_point;
      by_point << inverse, 0.0, -seen.x() * inverse, 0.0, inverse, -seen.y() * inverse;
      Eigen::Matrix3d minus_cross;
      minus_cross << 0.0, arm.z(), -arm.y(), -arm.z(), 0.0, arm.x(), arm.y(), -arm.x(), 0.0;
      Matrix26d jacobian;
      jacobian.leftCols<3>() = by_point;
      jacobian.rightCols<3>() = by_point * minus_cross;
      normal.noalias() += jacobian.transpose() * jacobian;
      right.noalias() -= jacobian.transpose() * error;
      squared += error.squaredNorm();
    }
    const Eigen::LDLT<Matrix6d> factors(normal);
    const Vector6d step = factors.solve(right);
    if (!step.allFinite()) return kInfinity;
    p_cam_target.translation() += step.head<3>();
    const double angle = step.tail<3>().norm();
    if (angle > 0.0) {
      p_cam_target.linear() = Eigen::AngleAxisd(angle, step.tail<3>() / angle).toRotationMatrix() *
                              p_cam_target.linear();
    }
    if (step.norm() < 1e-9) {
      return std::sqrt(squared / (2.0 * static_cast<double>(sightings.size())));
    }
  }
  return kInfinity;
}

}  // namespace dfr::vision::internal
