#include "dfr/kinematics/psm.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "dfr/kinematics/psm_chain.h"

namespace dfr::kinematics {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
// Distance along the shaft from the remote centre to the wrist-pitch axis at insertion 0, m.
constexpr double kShaftOffset = 0.4162 - 0.4318;
constexpr double kWristLength = 0.0091;  // m, from the wrist-pitch to the wrist-yaw axis

// Returns Rx(alpha) Tx(a) Rz(theta) Tz(d) for the joint value `q`.
Eigen::Isometry3d Link(const PsmLink& row, double q) noexcept {
  const double theta = row.theta + (row.prismatic ? 0.0 : q);
  const double d = row.d + (row.prismatic ? q : 0.0);
  const double ca = std::cos(row.alpha);
  const double sa = std::sin(row.alpha);
  const double ct = std::cos(theta);
  const double st = std::sin(theta);
  Eigen::Isometry3d link;
  link.matrix() << ct, -st, 0.0, row.a,  //
      ca * st, ca * ct, -sa, -sa * d,    //
      sa * st, sa * ct, ca, ca * d,      //
      0.0, 0.0, 0.0, 1.0;
  return link;
}

// Returns the orientation of the console's tool frame in the last link's frame.
Eigen::Matrix3d ToolRotation() noexcept {
  Eigen::Matrix3d r;
  r << 0.0, -1.0, 0.0, 0.0, 0.0, 1.0, -1.0, 0.0, 0.0;
  return r;
}

}  // namespace

const char* Name(PsmReach reach) noexcept {
  switch (reach) {
    case PsmReach::kOk:
      return "ok";
    case PsmReach::kInvalid:
      return "invalid";
    case PsmReach::kSingular:
      return "singular";
    case PsmReach::kJointLimit:
      return "joint-limit";
  }
  return "unknown";
}

// Limits from sawIntuitiveResearchKit 2.4, share/kinematic/PSM.json and PSM_Si.json; roll and wrist
// from LARGE_NEEDLE_DRIVER_400006.json and LARGE_NEEDLE_DRIVER_420006.json.
PsmJoints Psm::lower_limits(PsmGeneration generation) noexcept {
  PsmJoints q;
  q << -91 * kDegree, -53 * kDegree, 0.0, -260 * kDegree, -80 * kDegree, -80 * kDegree;
  if (generation == PsmGeneration::kSi) q.head<2>() << -2.964, -1.265;
  return q;
}

PsmJoints Psm::upper_limits(PsmGeneration generation) noexcept {
  PsmJoints q;
  q << 91 * kDegree, 53 * kDegree, 0.240, 260 * kDegree, 80 * kDegree, 80 * kDegree;
  if (generation == PsmGeneration::kSi) q.head<3>() << 2.964, 1.301, 0.290;
  return q;
}

bool Psm::WithinLimits(const PsmJoints& q, PsmGeneration generation) noexcept {
  return (q.array() >= lower_limits(generation).array()).all() &&
         (q.array() <= upper_limits(generation).array()).all();
}

// Without "flatten", -O1 compiles each coefficient of a product as a call, which is three times as
// slow.
[[gnu::flatten]] Eigen::Isometry3d Psm::Forward(const PsmJoints& q) noexcept {
  Eigen::Isometry3d pose = Link(kPsmLinks[0], q[0]);
  for (int i = 1; i < 6; ++i) pose = pose * Link(kPsmLinks[static_cast<std::size_t>(i)], q[i]);
  pose.linear() = pose.linear() * ToolRotation();
  return pose;
}

Eigen::Matrix<double, 6, 1> Psm::Twist(const PsmJoints& q, const PsmJoints& velocity) noexcept {
  Eigen::Matrix<double, 6, 1> twist = Eigen::Matrix<double, 6, 1>::Zero();
  if (velocity.isZero(0.0)) return twist;
  constexpr double kHalf = 5e-4;  // s, half the step of a central difference
  const Eigen::Isometry3d before = Forward(q - kHalf * velocity);
  const Eigen::Isometry3d after = Forward(q + kHalf * velocity);
  const Eigen::AngleAxisd turn(after.linear() * before.linear().transpose());
  twist << (after.translation() - before.translation()) / (2.0 * kHalf),
      turn.angle() / (2.0 * kHalf) * turn.axis();
  return twist;
}

Eigen::Vector3d Psm::Tip(const PsmJoints& q) noexcept {
  return Forward(q) * Eigen::Vector3d(0.0, 0.0, kJawLength);
}

int Psm::NumParts(const PsmJoints& way) noexcept {
  constexpr double kPart = 5e-4;  // m
  const double length = kReach * (way.cwiseAbs().sum() - std::abs(way[2])) + std::abs(way[2]);
  if (!std::isfinite(length)) return 1;
  return std::clamp(static_cast<int>(std::ceil(std::min(length / kPart, 1e6))), 1, kMostParts);
}

PsmReach Psm::Inverse(const Eigen::Isometry3d& pose, PsmJoints& q,
                      PsmGeneration generation) noexcept {
  if (!pose.matrix().allFinite()) return PsmReach::kInvalid;
  const Eigen::Matrix3d r6 = pose.linear() * ToolRotation().transpose();
  const Eigen::Vector3d p6 = pose.translation();

  // x5, from the wrist-pitch to the wrist-yaw axis, is normal to the yaw axis z6. The shaft's axis
  // z4, which passes through the origin, lies in the plane of x5 and z6 (both are normal to the
  // pitch axis). The point p6 on the wrist-yaw axis lies in that plane too. Removing its component
  // along z6 gives the direction of x5. The opposite direction would fold the wrist back by more
  // than a right angle.
  const Eigen::Vector3d z6 = r6.col(2);
  const Eigen::Vector3d normal_part = p6 - p6.dot(z6) * z6;
  if (normal_part.norm() < 1e-9) return PsmReach::kSingular;
  const Eigen::Vector3d x5 = normal_part.normalized();
  const Eigen::Vector3d p5 = p6 - kWristLength * x5;
  const double depth = p5.norm();
  if (depth < 1e-6) return PsmReach::kSingular;

  // The shaft's direction is (sin q0 cos q1, -sin q1, -cos q0 cos q1).
  const Eigen::Vector3d shaft = p5 / depth;
  q[0] = std::atan2(shaft.x(), -shaft.z());
  q[1] = -std::asin(std::fmin(1.0, std::fmax(-1.0, shaft.y())));
  q[2] = depth - kShaftOffset;
  const Eigen::Matrix3d r3 =
      (Link(kPsmLinks[0], q[0]) * Link(kPsmLinks[1], q[1]) * Link(kPsmLinks[2], q[2])).linear();
  const Eigen::Vector3d z5_in_3 = r3.transpose() * x5.cross(z6);
  q[3] = std::atan2(-z5_in_3.x(), z5_in_3.y());
  const Eigen::Matrix3d r4 = r3 * Link(kPsmLinks[3], q[3]).linear();
  const Eigen::Vector3d x5_in_4 = r4.transpose() * x5;
  q[4] = std::atan2(x5_in_4.x(), x5_in_4.z());
  const Eigen::Matrix3d r5 = r4 * Link(kPsmLinks[4], q[4]).linear();
  const Eigen::Vector3d x6_in_5 = r5.transpose() * r6.col(0);
  q[5] = std::atan2(x6_in_5.x(), x6_in_5.z());
  return WithinLimits(q, generation) ? PsmReach::kOk : PsmReach::kJointLimit;
}

PsmJoints PsmCorrection::Apply(const PsmJoints& q) const noexcept {
  return q + offset + scale.cwiseProduct(q - reference);
}

PsmJoints PsmCorrection::Invert(const PsmJoints& q) const noexcept {
  return reference + (q - offset - reference).cwiseQuotient((PsmJoints::Ones() + scale).eval());
}

}  // namespace dfr::kinematics
