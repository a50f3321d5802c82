#include "dfr/imitation/locally_weighted_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::imitation {
namespace {

// Returns demonstrations of u = 0.1 - 0.3 x at random x.
std::vector<core::Trajectory> Linear() {
  core::Random random(1);
  std::vector<core::Trajectory> demonstrations;
  for (int d = 0; d < 40; ++d) {
    core::Trajectory trajectory;
    trajectory.states.resize(11, 2);
    trajectory.controls.resize(10, 2);
    for (double& x : trajectory.states.reshaped()) x = random.Uniform(-1.0, 1.0);
    for (int t = 0; t < 10; ++t) {
      trajectory.controls.row(t) = (0.1 - 0.3 * trajectory.states.row(t).array()).matrix();
    }
    demonstrations.push_back(trajectory);
  }
  return demonstrations;
}

core::FeatureTransform Identity() {
  return core::FeatureTransform::Identity(core::FeatureSelection::All(2));
}

TEST(LocallyWeightedPolicyTest, AnInvalidStateGivesNaN) {
  const auto first =
      core::FeatureTransform::Identity(core::FeatureSelection({{{"a", 0, 1}, {"b", 1, 1}}}, "a"));
  const LocallyWeightedPolicy policy(first, Linear());
  for (const auto& x : {std::vector{0.1, std::numeric_limits<double>::infinity()}, {0.1}}) {
    std::vector<double> u(2);
    policy.Control(0, x, u);
    EXPECT_TRUE(std::isnan(u[0]) && std::isnan(u[1])) << x.size();
  }
}

// Locally linear regression of a linear law is exact up to the ridge.
TEST(LocallyWeightedPolicyTest, ReproducesALinearLaw) {
  const LocallyWeightedPolicy policy(Identity(), Linear(), {.ridge = 1e-6});
  core::Random random(2);
  std::vector<double> x(2), u(2);
  for (int i = 0; i < 200; ++i) {
    for (double& entry : x) entry = random.Uniform(-1.0, 1.0);
    policy.Control(static_cast<int>(random.Below(10)), x, u);
    for (std::size_t k = 0; k < 2; ++k) ASSERT_NEAR(u[k], 0.1 - 0.3 * x[k], 1e-6);
  }
}

TEST(LocallyWeightedPolicyTest, UsesOnlyNeighbouringTimeSteps) {
  auto demonstrations = Linear();
  for (auto& d : demonstrations) d.controls.bottomRows(5).setConstant(0.5);
  const LocallyWeightedPolicy policy(Identity(), demonstrations, {.window = 0});
  std::vector<double> u(2);
  policy.Control(2, std::vector{0.0, 0.0}, u);
  EXPECT_NEAR(u[0], 0.1, 0.02);  // error due to the ridge
  policy.Control(7, std::vector{0.0, 0.0}, u);
  EXPECT_NEAR(u[0], 0.5, 1e-6);
  policy.Control(1000, std::vector{0.0, 0.0}, u);
  EXPECT_NEAR(u[0], 0.5, 1e-6) << "the last step holds beyond the end";
}

// Controls are zero in the padding of episodes and in a pause of all demonstrations.
TEST(LocallyWeightedPolicyTest, RestingStepsUseTheNearestMovingOnes) {
  auto demonstrations = Linear();
  for (auto& d : demonstrations) {
    d.controls.middleRows(3, 7).setZero();
    d.controls.row(2).setConstant(0.5);
  }
  const LocallyWeightedPolicy policy(Identity(), demonstrations, {.window = 1});
  std::vector<double> u(2);
  for (const int t : {4, 9, 1000}) {
    policy.Control(t, std::vector{0.0, 0.0}, u);
    EXPECT_NEAR(u[0], 0.5, 1e-6);
  }
}

TEST(LocallyWeightedPolicyTest, FarAwayItStillGivesAControlWithinTheLimits) {
  const LocallyWeightedPolicy policy(Identity(), Linear());
  std::vector<double> u(2);
  const std::vector<double> far = {1e3, -1e3};
  {
    const test::NoAlloc guard;
    policy.Control(3, far, u);
  }
  for (const double entry : u) EXPECT_LE(std::abs(entry), 1.0);
}

// A curved law needs a narrow width, and a straight law with noise needs a wide width.
TEST(CrossValidatedWidthTest, FollowsTheLaw) {
  auto demonstrations = Linear();
  core::Random random(3);
  for (auto& d : demonstrations) {
    for (double& u : d.controls.reshaped()) u += random.Uniform(-0.2, 0.2);
  }
  const double wide = CrossValidatedWidth(Identity(), demonstrations);
  for (auto& d : demonstrations) {
    d.controls = 0.5 * (4.0 * d.states.topRows(10).array()).sin().matrix();
  }
  const double narrow = CrossValidatedWidth(Identity(), demonstrations);
  EXPECT_GE(wide, 1.0);
  EXPECT_LE(narrow, 0.35);
  demonstrations.resize(1);
  EXPECT_THROW((void)CrossValidatedWidth(Identity(), demonstrations), std::invalid_argument);
}

TEST(CrossValidatedWidthTest, EveryDemonstrationIsChecked) {
  for (const std::size_t d : {0u, 5u, 39u}) {
    const auto message = [&](auto&& change) {
      auto demonstrations = Linear();
      change(demonstrations[d]);
      return dfr::test::MessageOf(
          [&] { (void)CrossValidatedWidth(Identity(), demonstrations, {.width = 0.0}); });
    };
    const std::string named = "demonstration " + std::to_string(d) + " must have controls";
    EXPECT_THAT(message([](auto& one) { one.states.conservativeResize(3, 2); }),
                testing::HasSubstr(named));
    if (d == 0) continue;  // it sets the number of controls
    EXPECT_THAT(message([](auto& one) { one.controls.conservativeResize(10, 3); }),
                testing::HasSubstr(named));
  }
}

TEST(LocallyWeightedPolicyTest, InvalidArgumentsAreRefused) {
  EXPECT_THROW(LocallyWeightedPolicy(Identity(), {}), std::invalid_argument);
  EXPECT_THROW(LocallyWeightedPolicy(Identity(), Linear(), {.width = 0.0}), std::invalid_argument);
  EXPECT_THROW(LocallyWeightedPolicy(Identity(), Linear(), {.ridge = 0.0}), std::invalid_argument);
  auto still = Linear();
  for (auto& d : still) d.controls.setZero();
  EXPECT_THROW(LocallyWeightedPolicy(Identity(), still), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::imitation
