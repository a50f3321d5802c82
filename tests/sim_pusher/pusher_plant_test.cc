#include "dfr/sim/pusher/pusher_plant.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "dfr/core/random.h"
#include "tests/sim_pusher/arm_kinematics.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::sim {
namespace {

using core::PlantStatus;
using test::kObject;
using test::kTilt;
using test::kTip;
using test::MoveTip;
using test::Observe;
using test::WithObjectAt;
using State = std::vector<double>;
using Control = std::array<double, 7>;

constexpr double kTableZ = -0.325;

Control RandomControl(core::Random& random, double scale) {
  Control control;
  for (double& u : control) u = scale * random.Normal();
  return control;
}

// Pushes roughly forward with noise: most controls have contact.
Control NoisyPush(const PusherPlant& plant, core::Random& random) {
  const State s = Observe(plant);
  Control control = MoveTip(plant, {0.015, 0.5 * (s[kObject + 1] - s[kTip + 1])});
  for (double& u : control) u += 0.15 * random.Normal();
  return control;
}

TEST(PusherPlantTest, TheStateDescribesTheSceneAtHome) {
  const PusherPlant plant;
  EXPECT_EQ(plant.state_dim(), 25);
  EXPECT_EQ(core::FeatureSelection(plant.layout(), "red,object,tip").num_features(), 12);
  const core::FeatureSelection named(plant.layout(), "object,goal,red");
  const State s = Observe(plant);
  State part(named.num_features());
  named.Apply(s, part);
  EXPECT_DOUBLE_EQ(part[2], -0.275);
  EXPECT_THAT(State(part.begin() + 3, part.begin() + 5), testing::ElementsAre(0.76, 0.0));
  EXPECT_THAT(State(part.begin() + 6, part.end()),
              testing::ElementsAre(0.64, 0.15, kTableZ, 0.64, -0.15, kTableZ));
  // The home angles have 16 digits.
  EXPECT_NEAR(s[kTip], 0.35, 1e-12);
  EXPECT_NEAR(s[kTip + 1], 0.0, 1e-12);
  EXPECT_NEAR(s[kTip + 2], -0.285, 1e-12);
  for (int k = 0; k < 3; ++k) EXPECT_NEAR(s[kTilt + k], 0.0, 1e-12);
}

// Compares MuJoCo's chain with the chain computed from the documented dimensions.
TEST(PusherPlantTest, KinematicsAgreeWithTheDocumentedDimensions) {
  PusherPlant plant;
  core::Random random(2);
  State s = Observe(plant);
  for (int i = 0; i < 200; ++i) {
    for (int j = 0; j < 7; ++j) s[j] = random.Uniform(-0.9, 0.9) + (j == 3 ? 1.2 : 0.0);
    plant.SetState(s);
    const State seen = Observe(plant);
    const test::ArmPose pose = test::Forward(s, 0.025);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(seen[kTip + k], pose.tip[k], 1e-12);
    EXPECT_NEAR(seen[kTilt], 0.1 * pose.tip_frame(1, 0), 1e-12);
    EXPECT_NEAR(seen[kTilt + 1], 0.1 * pose.tip_frame(2, 0), 1e-12);
    EXPECT_NEAR(seen[kTilt + 2], 0.1 * pose.tip_frame(2, 1), 1e-12);
  }
}

TEST(PusherPlantTest, StartStatesAreUniformInTheirRectangleAndReproducible) {
  PusherPlant plant;
  constexpr int kStarts = 4000;
  double mean_x = 0.0;
  double mean_y = 0.0;
  double min_y = 1.0;
  double max_y = -1.0;
  for (int i = 0; i < kStarts; ++i) {
    plant.Reset(i);
    const State s = Observe(plant);
    ASSERT_GE(s[kObject], 0.43);
    ASSERT_LE(s[kObject], 0.49);
    ASSERT_LE(std::abs(s[kObject + 1]), 0.12);
    ASSERT_FALSE(plant.collided());
    mean_x += s[kObject] / kStarts;
    mean_y += s[kObject + 1] / kStarts;
    min_y = std::min(min_y, s[kObject + 1]);
    max_y = std::max(max_y, s[kObject + 1]);
  }
  // Four standard errors of a uniform mean: 4 width / sqrt(12 * 4000).
  EXPECT_NEAR(mean_x, 0.46, 4 * 0.06 / std::sqrt(12.0 * kStarts));
  EXPECT_NEAR(mean_y, 0.0, 4 * 0.24 / std::sqrt(12.0 * kStarts));
  EXPECT_LT(min_y, -0.119);  // missed with probability (1 - 1/240)^4000 < 1e-7
  EXPECT_GT(max_y, 0.119);

  plant.Reset(17);
  const State first = Observe(plant);
  ASSERT_EQ(plant.Apply(MoveTip(plant, {0.02, 0.0})), PlantStatus::kOk);
  plant.Reset(17);
  EXPECT_EQ(Observe(plant), first);
  plant.Reset(18);
  EXPECT_NE(Observe(plant), first);
}

TEST(PusherPlantTest, AControlIsAChangeOfPoseByTheJointStep) {
  const Control control = {0.5, -0.25, 0.1, 0.0, -1.0, 0.3, 1.0};
  for (const double step : {0.06, 0.03}) {
    PusherPlant plant({.joint_step = step});
    const State s = Observe(plant);
    ASSERT_EQ(plant.Apply(control), PlantStatus::kOk);
    const State after = Observe(plant);
    for (int j = 0; j < 7; ++j) EXPECT_DOUBLE_EQ(after[j], s[j] + step * control[j]);
  }
}

TEST(PusherPlantTest, SaturatesAtTheActuatorsLimit) {
  PusherPlant a;
  PusherPlant b;
  a.Reset(1);
  b.Reset(1);
  ASSERT_EQ(a.Apply(Control{7.0, -1.5, 0.2, 0.0, -3.0, 1.0, 1.0}), PlantStatus::kOk);
  ASSERT_EQ(b.Apply(Control{1.0, -1.0, 0.2, 0.0, -1.0, 1.0, 1.0}), PlantStatus::kOk);
  EXPECT_EQ(Observe(a), Observe(b));
  EXPECT_EQ(a.statistics().saturated, 1);
  EXPECT_EQ(b.statistics().saturated, 0);
}

TEST(PusherPlantTest, RefusesInvalidControlsWithoutMoving) {
  PusherPlant plant;
  plant.Reset(4);
  const State before = Observe(plant);
  Control control{};
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(),
        -std::numeric_limits<double>::infinity()}) {
    for (int j = 0; j < 7; ++j) {
      control.fill(0.5);
      control[j] = bad;
      EXPECT_EQ(plant.Apply(control), PlantStatus::kRefused);
    }
  }
  EXPECT_EQ(plant.Apply(std::span(control).first(6)), PlantStatus::kRefused);
  EXPECT_EQ(plant.Apply({}), PlantStatus::kRefused);
  EXPECT_EQ(Observe(plant), before);
  EXPECT_EQ(plant.statistics().controls, 0);
}

TEST(PusherPlantTest, StopsAtJointLimits) {
  PusherPlant plant;
  Control roll{};
  roll[6] = 1.0;
  for (int t = 0; t < 40; ++t) ASSERT_EQ(plant.Apply(roll), PlantStatus::kOk);
  EXPECT_DOUBLE_EQ(Observe(plant)[6], 1.5);
}

TEST(PusherPlantTest, SlidesAlongTheTableInsteadOfEnteringIt) {
  PusherPlant plant;
  core::Random random(8);
  for (int episode = 0; episode < 20; ++episode) {
    plant.Reset(episode);
    for (int t = 0; t < 60; ++t) {
      Control control = RandomControl(random, 0.5);
      control[1] += 0.4;  // down
      ASSERT_EQ(plant.Apply(control), PlantStatus::kOk);
      const State s = Observe(plant);
      for (const auto& part : test::Forward(s, 0.025).parts) {
        // Allows for the rounding of the forward kinematics.
        ASSERT_GE(std::min(part.a.z(), part.b.z()) - part.radius, kTableZ - 1e-12) << part.name;
      }
    }
  }
  EXPECT_GT(plant.statistics().stopped_by_table, 100);
}

// "The system comes to rest at each time step" (Sec. III): a further zero control changes nothing
// beyond the settle tolerance of 5 um per substep.
TEST(PusherPlantTest, IsAtRestAfterEveryControl) {
  PusherPlant plant;
  core::Random random(5);
  for (int episode = 0; episode < 10; ++episode) {
    plant.Reset(episode);
    for (int t = 0; t < 30; ++t) {
      ASSERT_EQ(plant.Apply(NoisyPush(plant, random)), PlantStatus::kOk);
      const State rest = Observe(plant);
      ASSERT_LE(plant.residual_speed(), 0.01);
      auto clone = plant.Clone();
      ASSERT_EQ(clone->Apply(Control{}), PlantStatus::kOk);
      State later(rest.size());
      clone->Observe(later);
      for (std::size_t i = 0; i < rest.size(); ++i) ASSERT_NEAR(later[i], rest[i], 2e-4);
    }
  }
  const PusherStatistics& statistics = plant.statistics();
  EXPECT_GT(statistics.simulated, 160);
  EXPECT_LE(statistics.max_rest_penetration_m, 5e-4);
}

TEST(PusherPlantTest, ACloneContinuesBitForBit) {
  PusherPlant plant;
  core::Random random(6);
  PusherPlant copy;  // a plant with another history
  PusherPlant restored;
  int moved = 0;
  for (int episode = 0; episode < 6; ++episode) {
    plant.Reset(100 + episode);
    for (int t = 0; t < 40; ++t) {
      const Control control = NoisyPush(plant, random);
      const auto clone = plant.Clone();
      ASSERT_EQ(copy.Apply(RandomControl(random, 1.0)), PlantStatus::kOk);
      copy.CopyStateFrom(plant);
      restored.SetState(Observe(plant));
      const State before = Observe(plant);
      ASSERT_EQ(plant.Apply(control), PlantStatus::kOk);
      ASSERT_EQ(clone->Apply(control), PlantStatus::kOk);
      ASSERT_EQ(copy.Apply(control), PlantStatus::kOk);
      ASSERT_EQ(restored.Apply(control), PlantStatus::kOk);
      const State after = Observe(plant);
      moved += after[kObject] != before[kObject];
      State of_clone(after.size());
      clone->Observe(of_clone);
      ASSERT_EQ(of_clone, after);
      ASSERT_EQ(Observe(copy), after);
      ASSERT_EQ(Observe(restored), after);
      ASSERT_EQ(clone->collided(), plant.collided());
      ASSERT_EQ(copy.completed(), plant.completed());
    }
  }
  EXPECT_GT(moved, 90) << "too few controls had contact";
}

TEST(PusherPlantTest, ApplyAndObserveNeverAllocate) {
  PusherPlant plant;
  const auto other = plant.Clone();
  core::Random random(9);
  State s(plant.state_dim());
  for (int episode = 0; episode < 5; ++episode) {
    plant.Reset(episode);
    for (int t = 0; t < 40; ++t) {
      const Control control = t % 2 == 0 ? NoisyPush(plant, random) : RandomControl(random, 0.7);
      const test::NoAlloc guard;
      ASSERT_EQ(plant.Apply(control), PlantStatus::kOk);
      plant.Observe(s);
      other->CopyStateFrom(plant);
      plant.Halt();
    }
  }
  EXPECT_GT(plant.statistics().simulated, 50);
}

// The bar pushes straight at the cylinder. The cylinder moves with the bar, never ahead of it or
// into it, and stops over the goal.
TEST(PusherPlantTest, AStraightPushCarriesTheCylinderToTheGoal) {
  PusherPlant plant;
  plant.SetState(WithObjectAt(Observe(plant), 0.45, 0.0));
  bool touched = false;
  int steps = 0;
  for (; steps < 60 && !plant.completed(); ++steps) {
    const double object_before = Observe(plant)[kObject];
    ASSERT_EQ(plant.Apply(MoveTip(plant, {0.018, 0.0})), PlantStatus::kOk);
    const State s = Observe(plant);
    if (s[kObject] > object_before) touched = true;
    if (touched) {
      // The arm's path bends by about 0.1 mm within a substep of 2 mm.
      const double gap = s[kObject] - s[kTip] - PusherPlant::kObjectRadius - 0.012;
      ASSERT_NEAR(gap, 0.0, 2e-4) << "step " << steps;
    }
    ASSERT_NEAR(s[kObject + 1], 0.0, 1e-6);
  }
  EXPECT_TRUE(plant.completed());
  EXPECT_FALSE(plant.collided());
  EXPECT_GT(steps, 15);
  EXPECT_LE(plant.statistics().max_penetration_m, 2e-4);
}

// Isotropic friction below a point, Coulomb friction 0.5 at the contact: while the push is within
// atan(0.5) of the bar's normal, the cylinder sticks to the bar and moves with it. Beyond that
// angle it slides along the bar and moves at that angle.
TEST(PusherPlantTest, PushesObliquelyWithinTheFrictionCone) {
  for (const double angle : {0.2, 0.4, 0.7}) {
    SCOPED_TRACE(angle);
    PusherPlant plant;
    plant.SetState(WithObjectAt(Observe(plant), 0.403, 0.0));
    // The step is small enough to keep the tip's height, because slip in z would reduce friction.
    const Eigen::Vector2d step = 0.002 * Eigen::Vector2d(std::cos(angle), std::sin(angle));
    ASSERT_EQ(plant.Apply(MoveTip(plant, step)), PlantStatus::kOk);  // closes the gap
    const State before = Observe(plant);
    ASSERT_EQ(plant.Apply(MoveTip(plant, step)), PlantStatus::kOk);
    const State after = Observe(plant);
    const double moved =
        std::atan2(after[kObject + 1] - before[kObject + 1], after[kObject] - before[kObject]);
    const double tip = std::atan2(after[kTip + 1] - before[kTip + 1], after[kTip] - before[kTip]);
    // 0.03 rad: the bar yaws by a few mrad during the push, and MuJoCo's friction cone is
    // regularised.
    EXPECT_NEAR(moved, std::min(tip, std::atan(0.5)), 0.03);
  }
}

TEST(PusherPlantTest, WrongStatesAndOptionsAreNamed) {
  PusherPlant plant;
  const auto refused = [&](const State& s) {
    return dfr::test::MessageOf<std::invalid_argument>([&] { plant.SetState(s); });
  };
  State s = Observe(plant);
  s[4] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(refused(s), testing::HasSubstr("entry 4"));
  s[4] = 0.0;
  s[3] = 4.0;
  EXPECT_THAT(refused(s), testing::HasSubstr("joint 3"));
  s.pop_back();
  EXPECT_THAT(refused(s), testing::HasSubstr("25 entries"));
  for (const auto& [options, name] :
       {std::pair(PusherOptions{.red_y = 0.1}, "red_y"),
        std::pair(PusherOptions{.start_x_min = 0.5, .start_x_max = 0.45}, "start_x_min"),
        std::pair(PusherOptions{.start_y = 0.3}, "start_y"),
        std::pair(PusherOptions{.joint_step = 0.2}, "joint_step")}) {
    EXPECT_THAT(dfr::test::MessageOf<std::invalid_argument>([&] { PusherPlant wrong(options); }),
                testing::HasSubstr(name));
  }
}

// A few values of one push, recorded when the supervisor was trained. They reveal a changed model
// or MuJoCo. A tolerance of 1e-9 m allows for another compiler's rounding, but not for other
// physics.
TEST(PusherPlantTest, GoldenTrace) {
  PusherPlant plant({.start_x_min = 0.43, .start_x_max = 0.53});
  plant.Reset(2018);
  core::Random random(2018);
  for (int t = 0; t < 20; ++t) {
    Control control = RandomControl(random, 0.1);
    control[1] += t < 8 ? -0.25 : 0.15;
    control[3] -= 0.75;
    control[5] += 0.75;
    ASSERT_EQ(plant.Apply(control), PlantStatus::kOk);
    if (t != 9 && t != 19) continue;
    SCOPED_TRACE(t);
    const double half_way[] = {0.528730117980, 0.003562122921, -0.279847090241, 0.580843793502,
                               0.002338432554};
    const double end[] = {0.640709647337, -0.002995740577, -0.297126501939, 0.692915743612,
                          -0.003703737336};
    const double* expected = t == 9 ? half_way : end;
    const State s = Observe(plant);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(s[kTip + k], expected[k], 1e-9);
    for (int k = 0; k < 2; ++k) EXPECT_NEAR(s[kObject + k], expected[3 + k], 1e-9);
  }
}

}  // namespace
}  // namespace dfr::sim
