#include "dfr/kinematics/psm.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <utility>

#include "dfr/core/random.h"
#include "dfr/kinematics/psm_chain.h"
#include "tests/kinematics/psm_home.h"
#include "tests/support/all_close.h"

namespace dfr::kinematics {
namespace {

using test::AllClose;

constexpr double kDegree = 0.017453292519943295;

PsmJoints RandomJoints(core::Random& random) {
  PsmJoints q;
  for (int i = 0; i < 6; ++i) {
    // Draws insertions at which the wrist is beyond the remote centre.
    const double low = i == 2 ? 0.05 : Psm::lower_limits()[i];
    q[i] = random.Uniform(low, Psm::upper_limits()[i]);
  }
  // Another full turn of the roll gives the same pose. The inverse returns the value nearest to 0.
  q[3] = random.Uniform(-3.1, 3.1);
  return q;
}

// The manual gives this pose as a check of its kinematic table.
TEST(PsmTest, HomeMatchesTheManual) {
  const Eigen::Isometry3d pose = Psm::Forward(test::PsmHome());
  EXPECT_TRUE(AllClose(pose.translation(), Eigen::Vector3d(0.0, 0.0, -0.1135), 1e-12));
  EXPECT_TRUE(AllClose(pose.linear().col(2), Eigen::Vector3d(0.0, 0.0, -1.0), 1e-12));
  EXPECT_TRUE(AllClose(Psm::Tip(test::PsmHome()), Eigen::Vector3d(0.0, 0.0, -0.1237), 1e-12));
}

TEST(PsmTest, OneDegreeOfYawOrPitchMovesTheWristByTwoMillimetres) {
  for (int joint : {0, 1}) {
    const PsmJoints q = test::PsmHomeWith(joint, kDegree);
    const double moved =
        (Psm::Forward(q).translation() - Psm::Forward(test::PsmHome()).translation()).norm();
    EXPECT_NEAR(moved, 0.1135 * kDegree, 1e-6);  // arc compared with chord
    EXPECT_NEAR(moved, 0.0020, 5e-5);
  }
}

// Insertion only moves the position along a line through the origin.
TEST(PsmTest, ShaftPassesThroughTheRemoteCentreInEveryConfiguration) {
  core::Random random(1);
  for (int i = 0; i < 200; ++i) {
    PsmJoints q = RandomJoints(random);
    q[4] = q[5] = 0.0;  // a straight wrist: the origin of the pose is on the shaft's axis
    const Eigen::Isometry3d pose = Psm::Forward(q);
    const Eigen::Vector3d axis = pose.linear().col(2);
    EXPECT_LT(pose.translation().cross(axis).norm(), 1e-12);
    EXPECT_GT(pose.translation().dot(axis), 0.0);
    // A straight wrist continues the shaft by the wrist's length.
    EXPECT_NEAR(pose.translation().norm(), q[2] - 0.0156 + 0.0091, 1e-15);
  }
}

TEST(PsmTest, InverseUndoesForward) {
  core::Random random(2);
  for (int i = 0; i < 2000; ++i) {
    SCOPED_TRACE(i);
    const PsmJoints q = RandomJoints(random);
    PsmJoints found;
    ASSERT_EQ(Psm::Inverse(Psm::Forward(q), found), PsmReach::kOk);
    // Rounding is magnified near a wrist yaw of 80 degrees, where the wrist is close to its
    // singularity.
    EXPECT_TRUE(AllClose(found, q, 1e-11));
  }
}

TEST(PsmTest, PosesAreRigidAndInsertionMovesTheTipByItsLength) {
  core::Random random(3);
  for (int i = 0; i < 50; ++i) {
    const PsmJoints q = RandomJoints(random);
    const Eigen::Isometry3d pose = Psm::Forward(q);
    EXPECT_TRUE(
        AllClose(pose.linear() * pose.linear().transpose(), Eigen::Matrix3d::Identity(), 1e-14));
    EXPECT_NEAR(pose.linear().determinant(), 1.0, 1e-14);
    PsmJoints further = q;
    further[2] += 0.01;
    EXPECT_NEAR((Psm::Tip(further) - Psm::Tip(q)).norm(), 0.01, 1e-14);
  }
}

// Compares two computations with the same table: frames as matrices, and one point from link to
// link. A wrist that turns about the shaft has no linear velocity on the shaft, and insertion does
// not turn it.
TEST(PsmTest, TwistIsTheDerivativeOfThePose) {
  PsmJoints q;
  q << 0.3, -0.2, 0.15, 0.4, 0.0, 0.0;
  const PsmJoints inserting = 0.05 * PsmJoints::Unit(2);
  const PsmJoints rolling = 2.0 * PsmJoints::Unit(3);
  EXPECT_NEAR(Psm::Twist(q, inserting).head<3>().norm(), 0.05, 1e-9);
  EXPECT_NEAR(Psm::Twist(q, inserting).tail<3>().norm(), 0.0, 1e-9);
  EXPECT_NEAR(Psm::Twist(q, rolling).tail<3>().norm(), 2.0, 1e-6);
  EXPECT_EQ(Psm::Twist(q, PsmJoints::Zero()).norm(), 0.0);
  q << 0.3, -0.2, 0.15, 0.4, 0.5, -0.6;
  PsmJoints velocity;
  velocity << 0.5, -0.4, 0.03, 1.0, -2.0, 1.5;
  const Eigen::Matrix<double, 6, 1> twist = Psm::Twist(q, velocity);
  constexpr double kStep = 1e-6;
  const Eigen::Isometry3d pose = Psm::Forward(q);
  const Eigen::Isometry3d next = Psm::Forward(q + kStep * velocity);
  EXPECT_TRUE(AllClose(twist.head<3>(), (next.translation() - pose.translation()) / kStep, 1e-4));
  const Eigen::Matrix3d spin = (next.linear() - pose.linear()) * pose.linear().transpose() / kStep;
  EXPECT_TRUE(AllClose(twist.tail<3>(), Eigen::Vector3d(spin(2, 1), spin(0, 2), spin(1, 0)), 1e-4));
}

TEST(PsmTest, TheChainForAnyNumberTypeGivesTheSameTip) {
  core::Random random(4);
  for (int i = 0; i < 100; ++i) {
    const PsmJoints q = RandomJoints(random);
    Eigen::Vector3d tip;
    PsmTip(q.data(), Psm::kJawLength, tip.data());
    EXPECT_TRUE(AllClose(tip, Psm::Tip(q), 1e-15));
  }
}

TEST(PsmTest, ReportsWhyAPoseCannotBeReached) {
  PsmJoints q;
  const auto at = [&q](const Eigen::Vector3d& place) {
    Eigen::Isometry3d pose = Psm::Forward(test::PsmHome());
    pose.translation() = place;
    return Psm::Inverse(pose, q);
  };
  EXPECT_EQ(at({std::numeric_limits<double>::quiet_NaN(), 0.0, -0.1135}), PsmReach::kInvalid);
  EXPECT_EQ(at(Eigen::Vector3d::Zero()), PsmReach::kSingular);
  EXPECT_EQ(at({0.0, 0.11, -0.05}), PsmReach::kJointLimit);
  EXPECT_EQ(at({0.0, 0.0, -0.30}), PsmReach::kJointLimit);
  EXPECT_GT(q[2], Psm::upper_limits()[2]);  // identifies the joint
}

// Without a known generation the Classic's limits apply, which are valid for both generations.
TEST(PsmTest, AnSiArmReachesWhatAClassicDoesAndMore) {
  constexpr PsmGeneration kSi = PsmGeneration::kSi;
  EXPECT_TRUE((Psm::lower_limits(kSi).array() <= Psm::lower_limits().array()).all());
  EXPECT_TRUE((Psm::upper_limits(kSi).array() >= Psm::upper_limits().array()).all());
  for (const auto& [joint, value] : {std::pair(0, 2.9), std::pair(0, -2.9), std::pair(1, 1.3),
                                     std::pair(1, -1.26), std::pair(2, 0.289)}) {
    const PsmJoints q = test::PsmHomeWith(joint, value);
    PsmJoints back;
    EXPECT_EQ(Psm::Inverse(Psm::Forward(q), back), PsmReach::kJointLimit) << joint;
    EXPECT_EQ(Psm::Inverse(Psm::Forward(q), back, kSi), PsmReach::kOk) << joint;
    EXPECT_TRUE(AllClose(back, q, 1e-9)) << joint;
    EXPECT_LT(Psm::Tip(q).norm(), Psm::kReach);
  }
  for (const auto& [joint, value] :
       {std::pair(0, 2.97), std::pair(1, 1.31), std::pair(1, -1.27), std::pair(2, 0.291)}) {
    EXPECT_FALSE(Psm::WithinLimits(test::PsmHomeWith(joint, value), kSi)) << joint;
  }
}

TEST(PsmTest, APartOfAMotionMovesTheTipByAtMostHalfAMillimetre) {
  const PsmJoints from = test::PsmHomeWith(0, -0.4);
  const PsmJoints way = test::PsmHomeWith(2, 0.2) - from;
  const int parts = Psm::NumParts(way);
  for (int i = 0; i < parts; ++i) {
    const auto tip = [&](int end) { return Psm::Tip(from + (1.0 * end / parts) * way); };
    EXPECT_LE((tip(i + 1) - tip(i)).norm(), 5e-4);
  }
  EXPECT_EQ(Psm::NumParts(PsmJoints::Zero()), 1);
  EXPECT_EQ(Psm::NumParts(PsmJoints::Constant(std::nan(""))), 1);
}

TEST(PsmTest, CorrectionInvertsItself) {
  PsmCorrection correction;
  correction.offset << 0.02, -0.01, 0.003, 0.1, -0.05, 0.04;
  correction.scale << 0.02, -0.03, 0.01, 0.0, 0.05, -0.02;
  correction.reference = test::PsmHome();
  const PsmJoints q = test::PsmHome() + PsmJoints::Constant(0.05);
  EXPECT_TRUE(AllClose(correction.Invert(correction.Apply(q)), q, 1e-15));
  EXPECT_NEAR(correction.Apply(q)[0], q[0] + 0.02 + 0.02 * 0.05, 1e-15);
}

}  // namespace
}  // namespace dfr::kinematics
