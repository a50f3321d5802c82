#include "dfr/experiment/finite_difference_recovery.h"

#include <gtest/gtest.h>

#include <memory>
#include <stdexcept>
#include <vector>

#include "dfr/control/published/switching_controller.h"
#include "tests/control/analytic.h"
#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::experiment {
namespace {

using test::PointPlant;

const std::vector<double> kLambda = {1.0};

TEST(FiniteDifferenceRecoveryTest, StepsAlongTheGradientWithDfrsStepSize) {
  const auto ball = test::UnitBall(3);
  PointPlant plant({.start = {0.6, 0.0, 0.3}, .gain = 2.0});
  FiniteDifferenceRecovery oracle(plant, ball, 1.0 / 500.0, 1.0 / 50.0);
  std::vector<double> u(3);
  const double g = ball.Decision(0, plant.x);
  {
    const test::NoAlloc guard;
    ASSERT_EQ(oracle.Next({.x = plant.x, .g = g, .lambda = 2.0}, u), control::Mode::kRecovery);
  }
  const double length = g / (50.0 * 2.0);
  const Eigen::Vector3d expected =
      -length * core::AsVector(std::span<const double>(plant.x)).normalized();
  // Central differences of a smooth function have a relative error of order h^2 = 1e-7.
  EXPECT_TRUE(test::AllClose(core::AsVector(std::span<const double>(u)), expected, 1e-6 * length));
}

TEST(FiniteDifferenceRecoveryTest, LeavesThePlantUnchanged) {
  const auto ball = test::UnitBall(2);
  PointPlant plant({.start = {0.5, 0.6}, .turns = true});
  plant.Reset(3);
  PointPlant untouched = plant;
  FiniteDifferenceRecovery oracle(plant, ball, 1.0 / 500.0, 1.0 / 50.0);
  std::vector<double> u(2);
  for (int i = 0; i < 10; ++i) {
    const double g = ball.Decision(0, plant.x);
    ASSERT_EQ(oracle.Next({.iteration = i, .x = plant.x, .g = g, .lambda = 1.0}, u),
              control::Mode::kRecovery);
    EXPECT_EQ(plant.x, untouched.x);
    ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
    ASSERT_EQ(untouched.Apply(u), core::PlantStatus::kOk);
    // The random stream is the same as without the oracle.
    ASSERT_EQ(plant.x, untouched.x);
  }
}

TEST(FiniteDifferenceRecoveryTest, HasNoDirectionWhereGIsFlatOrTheCopyRefuses) {
  const auto policy = test::ConstantPolicy(2, 1.0);
  std::vector<double> u(2);
  {
    const auto flat = test::ConstantSupport(2, 0.1);
    PointPlant plant({});
    control::SwitchingController oracle(policy, flat, kLambda,
                                        std::make_unique<FiniteDifferenceRecovery>(plant, flat));
    oracle.Reset(0);
    EXPECT_EQ(oracle.Next(plant.x, u).cause, control::HaltCause::kNoDirection);
  }
  const auto ball = test::UnitBall(2);
  PointPlant plant({.start = {0.9, 0.0}, .refuse_at = 0});
  control::SwitchingController oracle(policy, ball, kLambda,
                                      std::make_unique<FiniteDifferenceRecovery>(plant, ball));
  oracle.Reset(0);
  EXPECT_EQ(oracle.Next(plant.x, u).cause, control::HaltCause::kNoDirection);
}

TEST(FiniteDifferenceRecoveryTest, RefusesWrongOptions) {
  const auto ball = test::UnitBall(2);
  const PointPlant plant({.start = {0.0, 0.0, 0.0}});
  EXPECT_THROW(FiniteDifferenceRecovery(plant, ball, 0.1, 0.1), std::invalid_argument);
  EXPECT_THROW(FiniteDifferenceRecovery(plant, test::UnitBall(3), 0.0, 0.1), std::invalid_argument);
  EXPECT_THROW(FiniteDifferenceRecovery(plant, test::UnitBall(3), 0.1, 1.0), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::experiment
