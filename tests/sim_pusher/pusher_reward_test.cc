#include "dfr/sim/pusher/pusher_reward.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "tests/sim_pusher/arm_kinematics.h"

namespace dfr::sim {
namespace {

double Potential(const PusherPlant& plant) {
  const auto state = test::Observe(plant);
  double reach = 0.0;
  for (int k = 0; k < 3; ++k) {
    reach += std::pow(state[test::kTip + k] - state[test::kObject + k], 2);
  }
  return -20.0 * (std::sqrt(reach) + std::abs(state[test::kObject] - 0.76) +
                  4.0 * std::abs(state[test::kObject + 1]));
}

// A sum of potential differences telescopes: the reward depends on the end of an episode, not on
// its path.
TEST(PusherRewardTest, SumsToThePotentialGainedLessTheCosts) {
  PusherPlant plant;
  PusherReward reward(plant);
  plant.Reset(7);
  reward.Reset();
  const double before = Potential(plant);
  double sum = 0.0;
  double costs = 0.0;
  for (int t = 0; t < 6; ++t) {
    auto control = test::MoveTip(plant, {0.02, 0.0});
    control[6] = 2.0;  // saturated, with the effect of 1
    ASSERT_EQ(plant.Apply(control), core::PlantStatus::kOk);
    sum += reward.Step(control);
    for (const double u : control) costs += 0.05 * std::pow(std::clamp(u, -1.0, 1.0), 2);
  }
  ASSERT_FALSE(plant.collided());
  EXPECT_NEAR(sum, Potential(plant) - before - costs, 1e-12);  // rounding of 6 terms of order 1
}

TEST(PusherRewardTest, PaysForTheGoalAndChargesForACollision) {
  PusherPlant plant;
  PusherReward reward(plant);
  const std::array<double, 7> still{};
  plant.SetState(test::WithObjectAt(test::Observe(plant), 0.75, 0.0));
  reward.Reset();
  ASSERT_EQ(plant.Apply(still), core::PlantStatus::kOk);
  EXPECT_NEAR(reward.Step(still), 10.0, 1e-12);

  plant.SetState(test::WithObjectAt(test::Observe(plant), 0.64, 0.1));
  reward.Reset();
  ASSERT_TRUE(plant.collided());
  ASSERT_EQ(plant.Apply(still), core::PlantStatus::kOk);
  EXPECT_NEAR(reward.Step(still), -1.0, 1e-12);
}

}  // namespace
}  // namespace dfr::sim
