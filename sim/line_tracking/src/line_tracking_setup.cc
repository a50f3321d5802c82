// Poses and camera of the scene.
#include <cmath>
#include <numbers>

#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::sim {

Eigen::Isometry3d LineTrackingPlant::p_world_base() noexcept {
  constexpr double kInclination = 40.0 * std::numbers::pi / 180.0;
  // At home, the tip is kHover above the world's origin. The tool points along -z of the base.
  const Eigen::Vector3d up(0.0, std::sin(kInclination), std::cos(kInclination));
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear().col(0) = Eigen::Vector3d::UnitX();
  pose.linear().col(1) = up.cross(Eigen::Vector3d::UnitX());
  pose.linear().col(2) = up;
  kinematics::PsmJoints home = kinematics::PsmJoints::Zero();
  home[2] = 0.12;
  pose.translation() =
      Eigen::Vector3d(0.0, 0.0, kHover) - pose.linear() * kinematics::Psm::Tip(home);
  return pose;
}

Eigen::Isometry3d LineTrackingPlant::p_world_cam() noexcept {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  Eigen::Matrix3d down;
  down << 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0;
  pose.linear() = down * (Eigen::AngleAxisd(0.05, Eigen::Vector3d::UnitX()) *
                          Eigen::AngleAxisd(-0.03, Eigen::Vector3d::UnitY()) *
                          Eigen::AngleAxisd(0.02, Eigen::Vector3d::UnitZ()))
                             .toRotationMatrix();
  // The optical axis meets the gauze 1 mm from its centre.
  pose.translation() = Eigen::Vector3d(0.001, 0.0, 0.0) - 0.125 * pose.linear().col(2);
  return pose;
}

vision::CameraModel LineTrackingPlant::true_camera() noexcept {
  vision::CameraModel camera;
  camera.fx = 702.0;
  camera.fy = 699.0;
  camera.cx = 322.5;
  camera.cy = 236.0;
  camera.distortion = {-0.18, 0.05, 8e-4, -6e-4, 0.0};
  return camera;
}

vision::LineTarget LineTrackingPlant::target() { return line_task::StandardTarget(); }

}  // namespace dfr::sim
