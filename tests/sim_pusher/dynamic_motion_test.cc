#include "dynamic_motion.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "pusher_world.h"
#include "tests/sim_pusher/arm_kinematics.h"
#include "tests/support/no_alloc.h"

namespace dfr::sim {
namespace {

using core::PlantStatus;
using internal::DynamicMotion;
using test::kObject;
using test::MoveTip;
using test::Observe;
using test::WithObjectAt;
using Control = std::array<double, 7>;

PusherPlant Dynamic() { return PusherPlant({.physics = PusherPhysics::kDynamic}); }

// Motors with a stiffness of 2000 N m/rad stop within the error that 0.2 N m of joint friction can
// hold. Gravity has no visible effect.
TEST(DynamicMotionTest, JointsArriveWithinTheErrorThatFrictionHolds) {
  PusherPlant plant = Dynamic();
  core::Random random(1);
  for (int i = 0; i < 10; ++i) {
    const std::vector<double> before = Observe(plant);
    Control control;
    for (double& u : control) u = random.Uniform(-1.0, 1.0);
    control[1] = -std::abs(control[1]);  // up, off the table
    ASSERT_EQ(plant.Apply(control), PlantStatus::kOk);
    const std::vector<double> after = Observe(plant);
    for (std::size_t j = 0; j < 7; ++j) {
      const double wanted = before[j] + plant.options().joint_step * control[j];
      if (std::abs(wanted) > 1.0) continue;  // may be beyond a limit
      EXPECT_NEAR(after[j], wanted, 3e-4) << "joint " << j;
    }
  }
  EXPECT_EQ(plant.statistics().unsettled, 0);
}

TEST(DynamicMotionTest, AnArmWithoutControlStaysInPlace) {
  PusherPlant plant = Dynamic();
  const std::vector<double> before = Observe(plant);
  for (int i = 0; i < 20; ++i) ASSERT_EQ(plant.Apply(Control{}), PlantStatus::kOk);
  const std::vector<double> after = Observe(plant);
  for (std::size_t k = 0; k < before.size(); ++k) EXPECT_NEAR(after[k], before[k], 1e-4) << k;
}

// Coulomb friction: a cylinder with speed v stops after v^2 / (2 mu g).
TEST(DynamicMotionTest, TheCylinderSlidesTheCoulombDistance) {
  for (const double speed : {0.2, 0.4}) {
    PusherPlant plant = Dynamic();
    plant.SetState(WithObjectAt(Observe(plant), 0.5, 0.1));
    mjData* d = plant.data().mj.get();
    std::array<double, 7> still{};
    std::copy_n(d->qpos, 7, still.begin());
    DynamicMotion motion(plant.world().model.get(), d, still);
    d->qvel[7] = speed;
    while (!motion.Done()) ASSERT_TRUE(motion.Step());
    EXPECT_TRUE(motion.AtRest());
    EXPECT_NEAR(d->qpos[7] - 0.5, speed * speed / (2.0 * 0.5 * 9.81), 0.1 * speed * speed);
    EXPECT_NEAR(d->qpos[8], 0.1, 1e-6);
  }
}

// The gripper pushes the cylinder to the goal as in quasi-static motion, but the cylinder slides
// slightly ahead.
TEST(DynamicMotionTest, APushedCylinderSlidesAhead) {
  PusherPlant plant = Dynamic();
  plant.SetState(WithObjectAt(Observe(plant), 0.45, 0.0));
  double ahead = 0.0;
  for (int step = 0; step < 40 && !plant.completed(); ++step) {
    ASSERT_EQ(plant.Apply(MoveTip(plant, {0.018, 0.0})), PlantStatus::kOk);
    const std::vector<double> s = Observe(plant);
    ahead = std::max(ahead, s[kObject] - s[test::kTip] - PusherPlant::kObjectRadius - 0.012);
    ASSERT_LE(plant.residual_speed(), DynamicMotion::kRestObjectSpeed);
  }
  EXPECT_TRUE(plant.completed());
  EXPECT_FALSE(plant.collided());
  EXPECT_GT(ahead, 0.0002);
  EXPECT_EQ(plant.statistics().unsettled, 0);
  EXPECT_LE(plant.statistics().max_penetration_m, 2e-3);
}

TEST(DynamicMotionTest, ACloneContinuesBitForBitAndNothingIsAllocated) {
  PusherPlant plant = Dynamic();
  plant.SetState(WithObjectAt(Observe(plant), 0.41, 0.0));
  core::Random random(3);
  for (int t = 0; t < 8; ++t) {
    Control control = MoveTip(plant, {0.015, 0.0});
    for (double& u : control) u += 0.1 * random.Normal();
    const auto clone = plant.Clone();
    {
      const test::NoAlloc guard;
      ASSERT_EQ(plant.Apply(control), PlantStatus::kOk);
    }
    ASSERT_EQ(clone->Apply(control), PlantStatus::kOk);
    std::vector<double> of_clone(static_cast<std::size_t>(plant.state_dim()));
    clone->Observe(of_clone);
    ASSERT_EQ(of_clone, Observe(plant));
    ASSERT_EQ(clone->collided(), plant.collided());
  }
}

TEST(DynamicMotionTest, AnErrorInsideMujocoIsAFault) {
  PusherPlant plant = Dynamic();
  mjData* d = plant.data().mj.get();
  const int stack = d->nstack;
  d->nstack = 1;  // too little memory for the solver
  EXPECT_EQ(plant.Apply(Control{}), PlantStatus::kFault);
  d->nstack = stack;
  plant.Reset(3);
  EXPECT_EQ(plant.Apply(Control{}), PlantStatus::kOk);
}

}  // namespace
}  // namespace dfr::sim
