#include "dfr/kinematics/sprk_platform.h"

#include <cmath>
#include <numbers>
#include <utility>

namespace dfr::kinematics {
namespace {

constexpr double kBaseRadius = 3.0398 * 0.0254;
constexpr double kPlateRadius = 3.188 * 0.0254;
constexpr double kHalfPair = 0.540042611 / 2;  // half the angle between the two joints of a pair

// Returns the polar angle of the joints of leg i. The legs form three pairs, centred on 150, 30 and
// 270 degrees.
double JointAngle(int i) noexcept {
  constexpr std::array<double, 6> kPair = {150, 150, 30, 30, 270, 270};
  constexpr std::array<double, 6> kSide = {1, -1, 1, -1, 1, -1};
  const auto k = static_cast<std::size_t>(i);
  return kPair[k] * std::numbers::pi / 180.0 + kSide[k] * kHalfPair;
}

// Returns the direction of servo i's arm at angle 0: along the base's edge, away from the other
// servo of its pair.
double ArmDirection(int i) noexcept {
  constexpr std::array<double, 6> kBeta = {4 * std::numbers::pi / 3,
                                           std::numbers::pi / 3,
                                           2 * std::numbers::pi / 3,
                                           -std::numbers::pi / 3,
                                           0.0,
                                           std::numbers::pi};
  return kBeta[static_cast<std::size_t>(i)];
}

Eigen::Vector3d OnCircle(double radius, double angle) noexcept {
  return {radius * std::cos(angle), radius * std::sin(angle), 0.0};
}

// Solves m sin(a) + n cos(a) = l for the servo angle a. r is the arm's length, m = 2 r leg.z(), and
// n = 2 r (component of `leg` along the arm's direction at angle 0).
bool ServoAngle(const Eigen::Vector3d& leg, int i, double& angle) noexcept {
  constexpr double kArm = SprkPlatform::kArmLength;
  constexpr double kLeg = SprkPlatform::kLegLength;
  const double along = leg.dot(OnCircle(1.0, ArmDirection(i)));
  const double l = leg.squaredNorm() + kArm * kArm - kLeg * kLeg;
  const double m = 2.0 * kArm * leg.z();
  const double n = 2.0 * kArm * along;
  const double ratio = l / std::hypot(m, n);
  if (!(std::abs(ratio) <= 1.0)) return false;
  angle = std::remainder(std::asin(ratio) - std::atan2(n, m), 2.0 * std::numbers::pi);
  return std::abs(angle) <= SprkPlatform::kServoLimit;
}

Eigen::Matrix3d Rotation(double yaw, double pitch, double roll) noexcept {
  return (Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

// Returns the firmware's matrix for the plate: the transpose of a rotation, with two entries
// exchanged. It is not a rotation unless at most one angle differs from zero.
Eigen::Matrix3d FirmwareMatrix(const Eigen::Vector3d& angles_rad) noexcept {
  Eigen::Matrix3d matrix = Rotation(-angles_rad.z(), -angles_rad.y(), angles_rad.x()).transpose();
  std::swap(matrix(1, 2), matrix(2, 1));
  return matrix;
}

}  // namespace

Eigen::Isometry3d PlatformPose::Transform() const noexcept {
  Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
  transform.linear() = Rotation(angles_rad.z(), angles_rad.y(), angles_rad.x());
  transform.translation() = translation_m;
  return transform;
}

bool SprkPlatform::Inverse(const PlatformPose& pose, std::array<double, 6>& angles) noexcept {
  if (!pose.translation_m.allFinite() || !pose.angles_rad.allFinite()) return false;
  Eigen::Isometry3d plate = pose.Transform();
  plate.translation().z() += kHomeHeight;
  for (int i = 0; i < 6; ++i) {
    const Eigen::Vector3d leg = plate * PlateJoint(i) - ServoAxis(i);
    if (!ServoAngle(leg, i, angles[static_cast<std::size_t>(i)])) return false;
  }
  return true;
}

bool SprkPlatform::Reachable(const PlatformPose& pose) noexcept {
  std::array<double, 6> angles;
  return Inverse(pose, angles);
}

Eigen::Vector3d SprkPlatform::FirmwareJoint(const PlatformPose& pose, int i) noexcept {
  Eigen::Vector3d joint = pose.translation_m + FirmwareMatrix(pose.angles_rad) * PlateJoint(i);
  joint.z() += kHomeHeight;
  return joint;
}

bool SprkPlatform::FirmwareReaches(const PlatformPose& pose) noexcept {
  if (!pose.translation_m.allFinite() || !pose.angles_rad.allFinite()) return false;
  for (int i = 0; i < 6; ++i) {
    double angle = 0.0;
    if (!ServoAngle(FirmwareJoint(pose, i) - ServoAxis(i), i, angle)) return false;
  }
  return true;
}

double SprkPlatform::ReachableShare(const PlatformPose& pose) noexcept {
  constexpr int kSteps = 32;  // several, because the reachable set is not always convex
  double reached = 0.0;
  double beyond = 0.0;
  for (int i = 1; i <= kSteps; ++i) {
    const double share = static_cast<double>(i) / kSteps;
    if (!Reachable({share * pose.translation_m, share * pose.angles_rad})) {
      beyond = share;
      break;
    }
    reached = share;
  }
  if (reached == 1.0) return 1.0;
  while (beyond - reached > 1.0 / 1024.0) {
    const double middle = 0.5 * (reached + beyond);
    const bool ok = Reachable({middle * pose.translation_m, middle * pose.angles_rad});
    (ok ? reached : beyond) = middle;
  }
  return reached;
}

Eigen::Vector3d SprkPlatform::PlateJoint(int i) noexcept {
  return OnCircle(kPlateRadius, JointAngle(i));
}

Eigen::Vector3d SprkPlatform::ServoAxis(int i) noexcept {
  return OnCircle(kBaseRadius, JointAngle(i));
}

Eigen::Vector3d SprkPlatform::ArmEnd(int i, double angle) noexcept {
  Eigen::Vector3d end =
      ServoAxis(i) + kArmLength * std::cos(angle) * OnCircle(1.0, ArmDirection(i));
  end.z() = kArmLength * std::sin(angle);
  return end;
}

}  // namespace dfr::kinematics
