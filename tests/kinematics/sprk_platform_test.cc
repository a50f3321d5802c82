#include "dfr/kinematics/sprk_platform.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>

#include "dfr/core/random.h"

namespace dfr::kinematics {
namespace {

constexpr double kRadPerDegree = 0.017453292519943295;

// Entries 0-2 are the translation, 3-5 the angles.
PlatformPose Along(int entry, double value) {
  PlatformPose pose;
  (entry < 3 ? pose.translation_m[entry] : pose.angles_rad[entry - 3]) = value;
  return pose;
}

// Returns the range of one entry about home.
double Reach(int entry, double sign, double step) {
  double value = 0.0;
  while (SprkPlatform::Reachable(Along(entry, sign * (value + step)))) value += step;
  return value;
}

// Definition of the mechanism: each leg, from the end of its arm to the plate, keeps its length.
TEST(SprkPlatformTest, ServoAnglesGiveEveryLegItsLength) {
  core::Random random(1);
  int reachable = 0;
  for (int trial = 0; trial < 1000; ++trial) {
    PlatformPose pose;
    for (int k = 0; k < 3; ++k) {
      pose.translation_m[k] = random.Uniform(-0.01, 0.01);
      pose.angles_rad[k] = random.Uniform(-0.1, 0.1);
    }
    std::array<double, 6> angles;
    if (!SprkPlatform::Inverse(pose, angles)) continue;
    ++reachable;
    Eigen::Isometry3d plate = pose.Transform();
    plate.translation().z() += SprkPlatform::kHomeHeight;
    for (int i = 0; i < 6; ++i) {
      const double angle = angles[static_cast<std::size_t>(i)];
      const Eigen::Vector3d leg =
          plate * SprkPlatform::PlateJoint(i) - SprkPlatform::ArmEnd(i, angle);
      EXPECT_NEAR(leg.norm(), SprkPlatform::kLegLength, 1e-15);
      EXPECT_LE(std::abs(angle), SprkPlatform::kServoLimit);
    }
  }
  EXPECT_GT(reachable, 300);
  std::array<double, 6> home;
  ASSERT_TRUE(SprkPlatform::Inverse({}, home));
  for (double angle : home) EXPECT_NEAR(angle, home[0], 1e-12);
}

TEST(SprkPlatformTest, ReachMatchesTheFirmwaresGeometry) {
  struct Row {
    int entry;
    double sign, most;  // mm or degrees
  };
  for (const Row& row : {Row{2, 1, 8.3}, Row{2, -1, 17.1}, Row{0, 1, 27.4}, Row{0, -1, 27.4},
                         Row{1, 1, 29.8}, Row{1, -1, 26.7}, Row{3, 1, 8.3}, Row{4, 1, 6.1},
                         Row{4, -1, 6.1}, Row{5, 1, 23.3}, Row{5, -1, 23.3}}) {
    // The firmware's search, which accepts legs within 0.25 mm, goes up to 24.1 degrees of yaw.
    const double unit = row.entry < 3 ? 1e-3 : kRadPerDegree;
    EXPECT_NEAR(Reach(row.entry, row.sign, 0.02 * unit) / unit, row.most, 0.1) << row.entry;
  }
  EXPECT_FALSE(SprkPlatform::Reachable(Along(0, std::numeric_limits<double>::quiet_NaN())));
}

// The firmware's formula for the height of a joint (plate's frame: x, y, 0), with its left-handed
// yaw psi and pitch theta, and its roll phi.
TEST(SprkPlatformTest, FirmwareCombinesAnglesDifferently) {
  core::Random random(3);
  for (int trial = 0; trial < 100; ++trial) {
    PlatformPose pose;
    for (int k = 0; k < 3; ++k) {
      pose.translation_m[k] = random.Uniform(-0.01, 0.01);
      pose.angles_rad[k] = random.Uniform(-0.26, 0.26);
    }
    const double phi = pose.angles_rad.x();
    const double theta = -pose.angles_rad.y();
    const double psi = -pose.angles_rad.z();
    for (int i = 0; i < 6; ++i) {
      const Eigen::Vector3d plate = SprkPlatform::PlateJoint(i);
      const double height =
          (std::sin(psi) * std::sin(phi) + std::cos(psi) * std::cos(phi) * std::sin(theta)) *
              plate.x() +
          std::cos(theta) * std::sin(phi) * plate.y();
      const Eigen::Vector3d joint = SprkPlatform::FirmwareJoint(pose, i);
      EXPECT_NEAR(joint.z(), pose.translation_m.z() + SprkPlatform::kHomeHeight + height, 1e-15);
      EXPECT_NEAR(
          joint.x() - pose.translation_m.x(),
          std::cos(psi) * std::cos(theta) * plate.x() + std::sin(psi) * std::cos(theta) * plate.y(),
          1e-15);
    }
  }
  // For a single angle both plates are the same.
  for (int entry = 3; entry < 6; ++entry) {
    const PlatformPose pose = Along(entry, 0.2);
    for (int i = 0; i < 6; ++i) {
      Eigen::Vector3d joint = pose.Transform() * SprkPlatform::PlateJoint(i);
      joint.z() += SprkPlatform::kHomeHeight;
      EXPECT_LT((SprkPlatform::FirmwareJoint(pose, i) - joint).norm(), 1e-15) << entry;
    }
  }
  // Yaw of 15 and roll of 5 degrees: within the mechanism's reach, but not within the firmware's.
  PlatformPose pose;
  pose.angles_rad << 5 * kRadPerDegree, 0.0, 15 * kRadPerDegree;
  EXPECT_TRUE(SprkPlatform::Reachable(pose));
  EXPECT_FALSE(SprkPlatform::FirmwareReaches(pose));
  EXPECT_FALSE(SprkPlatform::FirmwareReaches(Along(3, std::nan(""))));
}

// The firmware reaches a pose if each servo can turn its arm to the leg's length from the joint.
TEST(SprkPlatformTest, FirmwareReachIsThatOfItsServos) {
  core::Random random(4);
  int reached = 0;
  for (int trial = 0; trial < 200; ++trial) {
    PlatformPose pose;
    for (int k = 0; k < 3; ++k) {
      pose.translation_m[k] = random.Uniform(-0.012, 0.012);
      pose.angles_rad[k] = random.Uniform(-0.15, 0.15);
    }
    double closest = 1.0;  // m, the smallest margin of a leg
    for (int i = 0; i < 6; ++i) {
      const Eigen::Vector3d joint = SprkPlatform::FirmwareJoint(pose, i);
      double shortest = 1.0;
      double longest = 0.0;
      for (int step = -100; step <= 100; ++step) {
        const double leg = (joint - SprkPlatform::ArmEnd(i, step * kRadPerDegree)).norm();
        shortest = std::fmin(shortest, leg);
        longest = std::fmax(longest, leg);
      }
      closest = std::fmin(closest, std::fmin(SprkPlatform::kLegLength - shortest,
                                             longest - SprkPlatform::kLegLength));
    }
    if (std::abs(closest) < 1e-5) continue;  // the search has steps of a degree
    EXPECT_EQ(SprkPlatform::FirmwareReaches(pose), closest > 0.0) << trial;
    reached += closest > 0.0;
  }
  EXPECT_GT(reached, 30);
  EXPECT_LT(reached, 170);
}

TEST(SprkPlatformTest, ReachableShareEndsAtTheBoundary) {
  PlatformPose far;
  far.translation_m << 0.03, 0.02, 0.02;
  far.angles_rad << 0.1, 0.0, 0.2;
  const double share = SprkPlatform::ReachableShare(far);
  EXPECT_GT(share, 0.1);
  EXPECT_LT(share, 0.9);
  const auto scaled = [&](double s) {
    return PlatformPose{s * far.translation_m, s * far.angles_rad};
  };
  EXPECT_TRUE(SprkPlatform::Reachable(scaled(share)));
  EXPECT_FALSE(SprkPlatform::Reachable(scaled(share + 2.0 / 1024)));
  EXPECT_EQ(SprkPlatform::ReachableShare(Along(0, 0.01)), 1.0);
}

TEST(SprkPlatformTest, RotationIsYawAfterPitchAfterRoll) {
  PlatformPose pose;
  pose.angles_rad << 90 * kRadPerDegree, 0.0, 90 * kRadPerDegree;
  // Roll rotates y to z. Yaw leaves z unchanged.
  EXPECT_LT((pose.Transform() * Eigen::Vector3d::UnitY() - Eigen::Vector3d::UnitZ()).norm(), 1e-15);
  // Roll leaves x unchanged. Yaw rotates x to y.
  EXPECT_LT((pose.Transform() * Eigen::Vector3d::UnitX() - Eigen::Vector3d::UnitY()).norm(), 1e-15);
}

}  // namespace
}  // namespace dfr::kinematics
