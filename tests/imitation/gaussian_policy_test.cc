#include "dfr/imitation/gaussian_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>

#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/temp_folder.h"

namespace dfr::imitation {
namespace {

using testing::HasSubstr;

core::StateLayout ObjectLayout() {
  core::StateLayout layout;
  layout.Add("object", 2);
  return layout;
}

// Returns a policy with mean (0.2, 5) in every state.
GaussianPolicy Policy(double limit) {
  Mlp mlp({2, 2});
  Eigen::VectorXd parameters = Eigen::VectorXd::Zero(mlp.num_parameters());
  parameters.tail(2) << 0.2, 5.0;
  mlp.SetParameters(parameters);
  return {
      MlpPolicy(ObjectLayout(), "", Whitening::Identity(2), mlp, Eigen::Vector2d::Constant(limit)),
      Eigen::Vector2d(std::log(0.5), std::log(0.1))};
}

TEST(GaussianPolicyTest, SamplesHaveTheMeanAndDeviationOfThePolicy) {
  const GaussianPolicy policy = Policy(100.0);
  constexpr int kDraws = 40000;
  core::Random random(1);
  const std::vector<double> x = {0.0, 0.0};
  std::vector<double> u(2);
  Eigen::Array2d sum = Eigen::Array2d::Zero(), squares = Eigen::Array2d::Zero();
  for (int i = 0; i < kDraws; ++i) {
    policy.Sample(x, random, u);
    const Eigen::Array2d error = Eigen::Array2d(u[0] - 0.2, u[1] - 5.0) / Eigen::Array2d(0.5, 0.1);
    sum += error;
    squares += error.square();
  }
  // The tolerances are four standard errors of the mean and the variance of a standard normal
  // variable.
  for (int i = 0; i < 2; ++i) {
    EXPECT_NEAR(sum[i] / kDraws, 0.0, 4.0 / std::sqrt(kDraws));
    EXPECT_NEAR(squares[i] / kDraws, 1.0, 4.0 * std::sqrt(2.0 / kDraws));
  }
}

// The noise is added before the clipping: with a mean of 5 and a limit of 1 no sample is inside. If
// the mean were clipped first, half of the samples would be inside.
TEST(GaussianPolicyTest, NoiseIsAddedBeforeClipping) {
  const GaussianPolicy policy = Policy(1.0);
  core::Random random(2);
  std::vector<double> u(2);
  for (int i = 0; i < 1000; ++i) {
    policy.Sample(std::vector<double>{0.0, 0.0}, random, u);
    EXPECT_EQ(u[1], 1.0);
    EXPECT_LE(std::abs(u[0]), 1.0);
  }
}

TEST(GaussianPolicyTest, TheSameStreamGivesTheSameControlsWithoutAllocating) {
  const GaussianPolicy policy = Policy(10.0);
  const std::vector<double> x = {0.0, 0.0};
  std::vector<double> first(2), second(2);
  core::Random a(3), b(3);
  const test::NoAlloc guard;
  policy.Sample(x, a, first);
  policy.Sample(x, b, second);
  EXPECT_EQ(first, second);
}

TEST(GaussianPolicyTest, ABrokenStateGivesNan) {
  core::Random random(4);
  std::vector<double> u(2, 0.0);
  Policy(1.0).Sample(std::vector<double>{0.0, std::numeric_limits<double>::quiet_NaN()}, random, u);
  EXPECT_TRUE(std::isnan(u[0]) && std::isnan(u[1]));
}

TEST(GaussianPolicyTest, AFileRestoresMeanAndDeviation) {
  const test::TempFolder folder;
  const GaussianPolicy policy = Policy(1.0);
  policy.Save(folder / "supervisor.dfr");
  const GaussianPolicy loaded = GaussianPolicy::Load(folder / "supervisor.dfr");
  EXPECT_EQ(loaded.log_std(), policy.log_std());
  EXPECT_EQ(loaded.mean().mlp().parameters(), policy.mean().mlp().parameters());
  EXPECT_THAT(
      test::MessageOf<std::runtime_error>([&] { MlpPolicy::Load(folder / "supervisor.dfr"); }),
      HasSubstr("gaussian-policy"));
}

TEST(GaussianPolicyTest, NeedsOneFiniteDeviationPerControl) {
  using Error = std::invalid_argument;
  EXPECT_THAT(
      test::MessageOf<Error>([] { GaussianPolicy(Policy(1.0).mean(), Eigen::Vector3d::Zero()); }),
      HasSubstr("2 controls, and 3 log"));
  EXPECT_THAT(test::MessageOf<Error>([] {
                GaussianPolicy(Policy(1.0).mean(),
                               Eigen::Vector2d(0, -std::numeric_limits<double>::infinity()));
              }),
              HasSubstr("log standard deviation 1 is -inf"));
}

}  // namespace
}  // namespace dfr::imitation
