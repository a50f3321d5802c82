#include "quasi_static_step.h"

#include <gtest/gtest.h>

#include <array>
#include <limits>

#include "dfr/sim/pusher/pusher_plant.h"
#include "pusher_world.h"
#include "tests/sim_pusher/arm_kinematics.h"

namespace dfr::sim {
namespace {

using core::PlantStatus;

// A state from which the next control needs a simulation step.
void BringNextToObject(PusherPlant& plant) {
  plant.SetState(test::WithObjectAt(test::Observe(plant), 0.4015, 0.0));
}

TEST(QuasiStaticStepTest, AnErrorInsideMujocoReturnsInsteadOfEndingTheProcess) {
  PusherPlant plant;
  BringNextToObject(plant);
  mjData* d = plant.data().mj.get();
  const int stack = d->nstack;
  d->nstack = 1;  // too little memory for the solver
  const std::array<double, 7> still{};
  EXPECT_EQ(plant.Apply(still), PlantStatus::kFault);
  d->nstack = stack;
  EXPECT_EQ(plant.Apply(still), PlantStatus::kFault) << "a fault stays";
  plant.Reset(3);
  EXPECT_EQ(plant.Apply(still), PlantStatus::kOk);
}

TEST(QuasiStaticStepTest, ADivergingStateIsAFaultAndResetRecovers) {
  PusherPlant plant;
  BringNextToObject(plant);
  const auto healthy = plant.Clone();
  plant.data().mj->qpos[7] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(internal::QuasiStaticStep(plant.world().model.get(), plant.data().mj.get()));
  plant.CopyStateFrom(*healthy);
  const std::array<double, 7> still{};
  PusherPlant fresh;
  fresh.CopyStateFrom(*healthy);
  EXPECT_EQ(fresh.Apply(still), PlantStatus::kOk);
  plant.Reset(5);
  EXPECT_EQ(plant.Apply(still), PlantStatus::kOk);
  fresh.Reset(5);
  EXPECT_EQ(fresh.Apply(still), PlantStatus::kOk);
  EXPECT_EQ(test::Observe(plant), test::Observe(fresh));
}

}  // namespace
}  // namespace dfr::sim
