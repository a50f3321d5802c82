#include "dfr/control/certified/certificate_constants.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "tests/control/analytic.h"

namespace dfr::control {
namespace {

core::FeatureTransform Doubled() {
  return {core::FeatureSelection::All(2), Eigen::Vector2d(1.0, -1.0),
          2.0 * core::Matrix::Identity(2, 2)};
}

// x' = x + 0.3 R u. R turns by 0.4 rad plus a random angle of up to `wobble` rad.
std::vector<core::Trajectory> Walks(int count, double wobble, std::uint64_t seed = 1) {
  core::Random random(seed);
  std::vector<core::Trajectory> walks;
  for (int d = 0; d < count; ++d) {
    core::Trajectory walk;
    walk.states.resize(11, 2);
    walk.controls.resize(10, 2);
    walk.states.row(0).setZero();
    for (int t = 0; t < 10; ++t) {
      const double a = random.Normal();
      const double b = random.Normal();
      const double angle = 0.4 + wobble * random.Uniform(-1.0, 1.0);
      walk.controls.row(t) << a, b;
      walk.states(t + 1, 0) = walk.states(t, 0) + 0.3 * (std::cos(angle) * a - std::sin(angle) * b);
      walk.states(t + 1, 1) = walk.states(t, 1) + 0.3 * (std::sin(angle) * a + std::cos(angle) * b);
    }
    walks.push_back(walk);
  }
  return walks;
}

TEST(CertificateConstantsTest, GainIsInFeatureUnits) {
  const auto gain = EstimateGain({Doubled(), Walks(59, 0.5)});
  EXPECT_NEAR(gain.value, 0.6, 1e-12);
  EXPECT_EQ(gain.demonstrations, 59);
  // Wilks: with 59 samples or more, the largest sample covers 95 % with 95 % confidence.
  EXPECT_NEAR(gain.coverage, 0.95, 1e-3);
  EXPECT_GE(gain.coverage, 0.95);
  EXPECT_LT(EstimateGain({Doubled(), Walks(58, 0.5)}).coverage, 0.95);
}

TEST(CertificateConstantsTest, DirectionErrorGrowsWithTheSpreadOfTheResponse) {
  // The system is linear: only the ridge keeps J from being exact.
  EXPECT_LT(EstimateDirectionError(Doubled(), Walks(40, 0.0)).value, 0.02);
  // A turn by up to 0.5 rad around the mean differs by at most 2 sin(0.25) K from the mean of all
  // turns. J is a mean of observed turns, and a turn differs by at most 2 sin(0.5) K from any J.
  std::vector<double> wobbly;
  for (std::uint64_t seed = 1; seed <= 11; ++seed) {
    wobbly.push_back(EstimateDirectionError(Doubled(), Walks(40, 0.5, seed)).value);
    EXPECT_GT(wobbly.back(), 0.15);
    EXPECT_LT(wobbly.back(), 2.0 * std::sin(0.5) * 0.6);
  }
  std::nth_element(wobbly.begin(), wobbly.begin() + 5, wobbly.end());
  EXPECT_LT(wobbly[5], 2.0 * std::sin(0.25) * 0.6 + 0.1);
}

TEST(CertificateConstantsTest, TheOrderOfDemonstrationsChangesNoBit) {
  const auto walks = Walks(23, 0.5);
  const double error = EstimateDirectionError(Doubled(), walks).value;
  for (std::uint64_t seed = 1; seed <= 10; ++seed) {
    auto permuted = walks;
    core::Random(seed).Shuffle(std::span(permuted));
    EXPECT_EQ(EstimateDirectionError(Doubled(), permuted).value, error);
  }
}

// J is that of x' = x + 0.3 R u. The response of one held-out demonstration is twice as large, and
// the error of J is largest at its first step: 0.6 in features.
TEST(CertificateConstantsTest, TheDirectionErrorIsTheLargestOfAllHeldOutSteps) {
  const Response response({Doubled(), Walks(40, 0.0)});
  auto walks = Walks(3, 0.0, 2);
  walks[1].states *= 2.0;
  EXPECT_NEAR(EstimateDirectionError(response, {Doubled(), walks}).value, 0.6, 0.01);
}

// J was fitted to other demonstrations. The share of further demonstrations below the constant is
// less than `coverage` in at most 5 % of fits.
TEST(CertificateConstantsTest, CoverageHoldsForAJacobianOfOtherDemonstrations) {
  int short_of = 0;
  constexpr int kRuns = 100;
  for (std::uint64_t run = 0; run < kRuns; ++run) {
    const auto demonstrations = Walks(20, 0.5, 1 + run);
    const Response response({Doubled(), std::span(demonstrations).first(10)});
    const auto error =
        EstimateDirectionError(response, {Doubled(), std::span(demonstrations).subspan(10)});
    EXPECT_EQ(error.demonstrations, 10);
    int below = 0;
    constexpr int kFurther = 100;
    for (const auto& walk : Walks(kFurther, 0.5, 5000 + run)) {
      below +=
          EstimateDirectionError(response, {Doubled(), {&walk, 1}}).value <= error.value ? 1 : 0;
    }
    short_of += below < error.coverage * kFurther ? 1 : 0;
  }
  // Binomial(100, 0.05): mean 5, standard deviation 2.2. Allows three standard deviations.
  EXPECT_LE(short_of, 5 + 7);
}

// Definition of coverage: in about 5 % of estimates the share of new demonstrations below the
// estimated constant is less than `coverage`.
TEST(CertificateConstantsTest, CoverageHolds) {
  core::Random random(3);
  int short_of = 0;
  constexpr int kRuns = 400;
  for (int run = 0; run < kRuns; ++run) {
    // Each demonstration has one step with |dz| / |u| uniform in (0, 1): the share below s is s.
    std::vector<core::Trajectory> walks(20);
    for (auto& walk : walks) {
      walk.states.resize(2, 1);
      walk.states << 0.0, random.Uniform();
      walk.controls.resize(1, 1);
      walk.controls << 1.0;
    }
    const auto gain =
        EstimateGain({core::FeatureTransform::Identity(core::FeatureSelection::All(1)), walks});
    short_of += gain.value < gain.coverage ? 1 : 0;
  }
  // Binomial(400, 0.05): mean 20, standard deviation 4.4. Allows three standard deviations.
  EXPECT_NEAR(short_of, 20, 13);
}

// A demonstration without a control has no ratio, so it is no evidence of coverage.
TEST(CertificateConstantsTest, DemonstrationsWithoutAControlDoNotCount) {
  const Response response({Doubled(), Walks(10, 0.5)});
  auto walks = Walks(6, 0.5, 2);
  for (std::size_t d : {0, 2, 5}) walks[d].controls.setZero();
  const double coverage = std::pow(0.05, 1.0 / 3.0);
  for (const EstimatedConstant& constant :
       {EstimateGain({Doubled(), walks}), EstimateDirectionError(Doubled(), walks),
        EstimateDirectionError(response, {Doubled(), walks})}) {
    EXPECT_EQ(constant.demonstrations, 3);
    EXPECT_NEAR(constant.coverage, coverage, 1e-12);
    EXPECT_LT(constant.value, 1.0) << "features that change without a control do not count";
  }
  for (auto& walk : walks) walk.controls.setZero();
  EXPECT_THROW((void)EstimateDirectionError(response, {Doubled(), walks}), std::invalid_argument);
}

TEST(CertificateConstantsTest, TheLargestChangeAtRestCountsOnlyZeroControls) {
  auto walks = Walks(3, 0.5);
  EXPECT_EQ(LargestChangeAtRest({Doubled(), walks}), 0.0);
  walks[1].controls.row(4).setZero();
  const double change = (walks[1].states.row(5) - walks[1].states.row(4)).norm();
  EXPECT_NEAR(LargestChangeAtRest({Doubled(), walks}), 2.0 * change, 1e-12);
}

TEST(CertificateConstantsTest, RefusesInvalidArguments) {
  EXPECT_THROW((void)EstimateGain({Doubled(), {}}), std::invalid_argument);
  EXPECT_THROW((void)EstimateGain({Doubled(), Walks(3, 0.0)}, 1.0), std::invalid_argument);
  EXPECT_THROW((void)EstimateDirectionError(Doubled(), Walks(1, 0.0)), std::invalid_argument);
  auto still = Walks(3, 0.0);
  for (auto& walk : still) walk.controls.setZero();
  EXPECT_THROW((void)EstimateGain({Doubled(), still}), std::invalid_argument);
  EXPECT_THROW((void)EstimateDirectionError(Doubled(), still), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::control
