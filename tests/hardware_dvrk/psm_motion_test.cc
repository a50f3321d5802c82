#include "dfr/hardware/psm_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <initializer_list>
#include <limits>
#include <stdexcept>

#include "dfr/core/random.h"
#include "tests/kinematics/psm_home.h"
#include "tests/support/all_close.h"

namespace dfr::hardware {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

constexpr double kDegree = 0.017453292519943295;

PsmJoints Off(int joint, double by) {
  return test::PsmHomeWith(joint, test::PsmHome()[joint] + by);
}

PsmMotion AtHome(const PsmLimits& limits = {}, PsmProfile profile = PsmProfile::kSmooth) {
  PsmMotion motion(limits, profile);
  motion.Rest(test::PsmHome());
  return motion;
}

TEST(PsmMotionTest, LinearMoveHasConstantSpeed) {
  PsmMotion motion = AtHome({}, PsmProfile::kLinear);
  PsmJoints goal = Off(0, 0.02);
  goal[2] += 0.01;
  ASSERT_EQ(motion.Start(goal, 1.0), PsmStatus::kOk);
  for (int i = 1; i <= 50; ++i) {
    motion.Advance(0.02);
    const PsmJoints expected = test::PsmHome() + (i / 50.0) * (goal - test::PsmHome());
    ASSERT_TRUE(test::AllClose(motion.setpoint(), expected, 1e-15)) << i;
    ASSERT_EQ(motion.moving(), i < 50);
  }
  EXPECT_EQ(motion.setpoint(), goal);  // exactly, for any sum of the steps
}

// For any times between calls, no step exceeds the speed limits.
TEST(PsmMotionTest, EveryStepKeepsToTheSpeedLimits) {
  core::Random random(11);
  for (const PsmProfile profile : {PsmProfile::kSmooth, PsmProfile::kLinear}) {
    PsmMotion motion = AtHome({}, profile);
    const PsmLimits& limits = motion.limits();
    for (int move = 0; move < 8; ++move) {
      PsmJoints goal;
      for (int i = 0; i < 6; ++i) goal[i] = random.Uniform(-0.6, 0.6);
      goal[2] = random.Uniform(0.05, 0.2);
      ASSERT_EQ(motion.Start(goal, motion.ShortestDuration(goal)), PsmStatus::kOk);
      while (motion.moving()) {
        const PsmJoints before = motion.setpoint();
        const double dt = random.Uniform(1e-4, 5e-3);
        motion.Advance(dt);
        const PsmJoints step = (motion.setpoint() - before).cwiseAbs();
        // The last step may compensate for a microsecond between the clocks.
        ASSERT_TRUE((step.array() <= (dt + 2e-6) * limits.max_speed.array() + 1e-12).all());
        const double tip = (Psm::Tip(motion.setpoint()) - Psm::Tip(before)).norm();
        // The tip's speed varies slightly between the samples of ShortestDuration().
        ASSERT_LE(tip, 1.02 * (dt + 2e-6) * limits.max_tip_speed + 1e-9);
      }
      ASSERT_EQ(motion.setpoint(), goal);
    }
  }
}

TEST(PsmMotionTest, SmoothMoveStartsAndEndsAtRest) {
  PsmMotion motion = AtHome();
  const PsmJoints goal = Off(1, 0.1);
  ASSERT_EQ(motion.Start(goal, 2.0), PsmStatus::kOk);
  motion.Advance(0.005);
  // s^2 (3 - 2 s) of s = 1/400
  EXPECT_NEAR(motion.setpoint()[1], 0.1 * (3.0 - 0.005) / 160000.0, 1e-12);
  motion.Advance(0.995);
  EXPECT_NEAR(motion.setpoint()[1], 0.05, 1e-12);
}

TEST(PsmMotionTest, RefusesAndChangesNothing) {
  PsmLimits limits;
  limits.upper[0] = 0.3;
  limits.workspace_min_m << -0.05, -0.05, -0.2;
  limits.workspace_max_m << 0.05, 0.05, -0.05;
  PsmMotion motion = AtHome(limits);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(motion.Start(Off(3, nan), 1.0), PsmStatus::kInvalidGoal);
  EXPECT_EQ(motion.Start(Off(3, 0.1), nan), PsmStatus::kInvalidGoal);
  EXPECT_EQ(motion.Start(Off(3, 0.1), -1.0), PsmStatus::kInvalidGoal);
  EXPECT_EQ(motion.Start(Off(0, 0.31), 100.0), PsmStatus::kBeyondLimits);
  EXPECT_EQ(motion.Start(Off(2, 0.121), 100.0), PsmStatus::kBeyondLimits);
  EXPECT_EQ(motion.Start(Off(2, 0.10), 100.0), PsmStatus::kOutsideWorkspace);
  EXPECT_EQ(motion.Start(Off(0, 0.1), 0.1), PsmStatus::kTooFast);
  EXPECT_EQ(motion.Start(Off(0, 0.1), 0.0), PsmStatus::kTooFast);
  // A pose does not distinguish a roll of 200 degrees from one of -160 degrees.
  EXPECT_EQ(motion.Start(Off(3, 200 * kDegree), 100.0), PsmStatus::kUnreachable);
  EXPECT_FALSE(motion.moving());
  motion.Advance(1.0);
  EXPECT_EQ(motion.setpoint(), test::PsmHome());
  EXPECT_EQ(motion.Start(test::PsmHome(), 0.0), PsmStatus::kOk);
}

TEST(PsmMotionTest, AConfiguredSiMovesFarther) {
  PsmLimits limits;
  PsmMotion classic = AtHome(limits);
  EXPECT_EQ(classic.Start(Off(2, 0.13), 100.0), PsmStatus::kBeyondLimits);
  EXPECT_EQ(classic.Start(Off(1, 1.2), 100.0), PsmStatus::kBeyondLimits);
  limits = PsmLimits::Of(kinematics::PsmGeneration::kSi);
  limits.workspace_min_m << -0.3, -0.3, -0.3;
  limits.workspace_max_m << 0.3, 0.3, 0.3;
  PsmMotion si = AtHome(limits);
  EXPECT_EQ(si.Start(Off(2, 0.171), 100.0), PsmStatus::kBeyondLimits);
  EXPECT_EQ(si.Start(Off(2, 0.13), 100.0), PsmStatus::kOk);
  si.Rest(test::PsmHome());
  EXPECT_EQ(si.Start(Off(1, 1.2), 100.0), PsmStatus::kOk);
  si.Rest(test::PsmHome());
  EXPECT_EQ(si.Start(Off(0, 2.9), 100.0), PsmStatus::kOk);
  // These limits exceed the limits of a Classic.
  limits.generation = kinematics::PsmGeneration::kClassic;
  EXPECT_THROW(PsmMotion(limits, PsmProfile::kSmooth), std::invalid_argument);
}

// Both ends are inside, but the path between them is not.
TEST(PsmMotionTest, WorkspaceLimitsTheWholePath) {
  PsmLimits limits;
  // On a straight path in joint space the tip is lower in the middle than at both ends.
  limits.workspace_min_m << -1.0, -1.0, -0.115;
  PsmMotion motion(limits, PsmProfile::kSmooth);
  motion.Rest(Off(0, -0.5));
  ASSERT_GT(Psm::Tip(Off(0, -0.5)).z(), -0.115);
  ASSERT_LT(Psm::Tip(test::PsmHome()).z(), -0.115);
  EXPECT_EQ(motion.Start(Off(0, 0.5), 100.0), PsmStatus::kOutsideWorkspace);
  EXPECT_EQ(motion.Start(Off(0, -0.45), 100.0), PsmStatus::kOk);
}

// An arm that was led outside must be able to return.
TEST(PsmMotionTest, FromOutsideTheWorkspaceItMayReturnButNotMoveFartherOut) {
  PsmLimits limits;
  const double floor = Psm::Tip(Off(2, 0.05)).z() + 1e-6;
  limits.workspace_min_m << -1.0, -1.0, floor;
  PsmMotion motion(limits, PsmProfile::kSmooth);
  const PsmJoints out = Off(2, 0.06);  // 10 mm below the floor
  motion.Rest(out);
  EXPECT_EQ(motion.Start(Off(2, 0.061), 100.0), PsmStatus::kOutsideWorkspace);
  EXPECT_EQ(motion.Start(Off(2, 0.058), 100.0), PsmStatus::kOk) << "nearer, but still outside";
  motion.Rest(out);
  EXPECT_EQ(motion.Start(Off(2, 0.04), 100.0), PsmStatus::kOk);
  // The path leads out again.
  motion.Rest(Off(2, 0.04));
  EXPECT_EQ(motion.Start(Off(2, 0.058), 100.0), PsmStatus::kOutsideWorkspace);
}

// A tip that is outside one face must not leave through another.
TEST(PsmMotionTest, FromOutsideOneFaceItMayNotLeaveThroughAnother) {
  PsmLimits limits;
  const Eigen::Vector3d start = Psm::Tip(test::PsmHome());
  limits.workspace_min_m = start - Eigen::Vector3d(0.1, 0.1, 0.001);
  limits.workspace_max_m = start + Eigen::Vector3d(-0.02, 0.1, 0.1);  // 20 mm outside in x
  PsmMotion motion(limits, PsmProfile::kSmooth);
  motion.Rest(test::PsmHome());
  EXPECT_EQ(motion.Start(Off(2, 0.01), 100.0), PsmStatus::kOutsideWorkspace) << "below the floor";
  PsmJoints goal = Off(0, -0.1);
  goal[2] += 0.01;
  ASSERT_LT(Psm::Tip(goal).x(), start.x() - 0.001);
  EXPECT_EQ(motion.Start(goal, 100.0), PsmStatus::kOutsideWorkspace) << "nearer, but lower";
  goal[2] -= 0.012;
  EXPECT_EQ(motion.Start(goal, 100.0), PsmStatus::kOk);
}

// The console clips goals at the limits. A joint at its limit is a valid start and a valid goal.
TEST(PsmMotionTest, AJointMayRestAtItsLimit) {
  core::Random random(7);
  for (int joint = 0; joint < 6; ++joint) {
    if (joint == 3) continue;  // beyond half a turn of roll the pose is ambiguous
    for (int trial = 0; trial < 40; ++trial) {
      PsmLimits limits;
      limits.workspace_min_m.setConstant(-1.0);
      limits.workspace_max_m.setConstant(1.0);
      PsmJoints inside = test::PsmHome();
      for (int i = 0; i < 6; ++i) inside[i] += (i == 2 ? 0.02 : 0.3) * random.Uniform(-1.0, 1.0);
      PsmJoints limit = inside;
      limit[joint] = trial % 2 == 0 ? limits.upper[joint] : limits.lower[joint];
      if (joint == 2) limit[joint] = limits.upper[joint];  // 0 is behind the remote centre
      PsmMotion motion(limits, PsmProfile::kSmooth);
      motion.Rest(inside);
      ASSERT_EQ(motion.Start(limit, 1000.0), PsmStatus::kOk) << joint << ' ' << trial;
      motion.Rest(limit);
      ASSERT_EQ(motion.Start(inside, 1000.0), PsmStatus::kOk) << joint << ' ' << trial;
      limit[joint] += trial % 2 == 0 || joint == 2 ? 1e-6 : -1e-6;
      EXPECT_EQ(motion.Start(limit, 1000.0), PsmStatus::kBeyondLimits);
    }
  }
}

// Withdrawn beyond the remote centre, the shaft would point in the opposite direction.
TEST(PsmMotionTest, PathThroughTheRemoteCentreIsRefused) {
  PsmMotion motion = AtHome();
  EXPECT_EQ(motion.Start(Off(2, -0.12), 100.0), PsmStatus::kUnreachable);
  EXPECT_EQ(motion.Start(Off(2, -0.10), 100.0), PsmStatus::kOk);
}

TEST(PsmMotionTest, InvalidLimitsAreRefused) {
  using Change = void (*)(PsmLimits&);
  for (const Change change : std::initializer_list<Change>{
           [](auto& l) { l.max_speed[4] = 0.0; },
           [](auto& l) { l.upper[1] = 2.0; },  // beyond the arm's own limit
           [](auto& l) { l.workspace_max_m.x() = l.workspace_min_m.x(); }}) {
    PsmLimits limits;
    change(limits);
    EXPECT_THROW(PsmMotion(limits, PsmProfile::kSmooth), std::invalid_argument);
  }
  EXPECT_THROW(PsmRest({.settle_s = -1.0}), std::invalid_argument);
}

TEST(PsmRestTest, RestNeedsDistanceAndSpeedForTheSettlingTime) {
  PsmRest rest({.settle_s = 0.1});
  const PsmJoints still = PsmJoints::Zero();
  EXPECT_FALSE(rest.At(0.0));
  rest.Sample(test::PsmHome(), still, test::PsmHome(), 1.00);
  EXPECT_FALSE(rest.At(1.09));
  EXPECT_TRUE(rest.At(1.10));
  rest.Sample(Off(2, 0.0011), still, test::PsmHome(), 1.11);  // 1.1 mm of insertion away
  EXPECT_FALSE(rest.At(1.3));
  rest.Sample(test::PsmHome(), still, test::PsmHome(), 1.2);
  EXPECT_FALSE(rest.At(1.25));
  rest.Sample(test::PsmHome(), Off(2, 0.0) - Off(2, 0.003), test::PsmHome(), 1.25);  // 3 mm/s
  EXPECT_FALSE(rest.At(2.0));
  rest.Sample(test::PsmHome(), still, test::PsmHome(), 2.0);
  EXPECT_TRUE(rest.At(2.2));
  rest.Forget();
  EXPECT_FALSE(rest.At(3.0));
}

}  // namespace
}  // namespace dfr::hardware
