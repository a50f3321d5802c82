#include "dfr/kernel/whitened_support.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <span>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "tests/kernel/support/walks.h"
#include "tests/support/no_alloc.h"

namespace dfr::kernel {
namespace {

// The walks spread out with time.
std::vector<core::Matrix> Walks(int count) { return dfr::test::Walks(count, 1, 0.3); }

TEST(WhitenedSupportTest, LogFormHasTheSignOfGAndGradientsAreDerivatives) {
  const auto support = WhitenedSupport::Fit(Walks(60));
  core::Random random(2);
  std::vector<double> z(2), gradient(2), log_gradient(2), unused(2);
  for (int i = 0; i < 300; ++i) {
    const int t = static_cast<int>(random.Below(14));
    for (double& entry : z) entry = random.Uniform(-2.0, 12.0);
    const double g = support.Gradient(t, z, gradient);
    const double l = support.LogDecision(t, z, log_gradient);
    ASSERT_EQ(support.Decision(t, z), g);
    ASSERT_EQ(support.LogDecision(t, z, {}), l);
    if (std::abs(g) > 1e-12) {
      ASSERT_EQ(g > 0.0, l > 0.0);
    }
    for (std::size_t k = 0; k < 2; ++k) {
      constexpr double kStep = 1e-5;
      std::vector<double> ahead = z, behind = z;
      ahead[k] += kStep;
      behind[k] -= kStep;
      // The error of central differences is kStep^2 times third derivatives of order one, plus
      // rounding / kStep.
      ASSERT_NEAR(gradient[k],
                  (support.Decision(t, ahead) - support.Decision(t, behind)) / (2 * kStep), 1e-8);
      ASSERT_NEAR(
          log_gradient[k],
          (support.LogDecision(t, ahead, {}) - support.LogDecision(t, behind, {})) / (2 * kStep),
          1e-6 * (1.0 + std::abs(log_gradient[k])));
    }
  }
}

// Checks l(z + d) >= l(z) + d . grad l(z) - c |d|^2, on which certificates are based.
TEST(WhitenedSupportTest, TheCurvatureBoundHolds) {
  const auto support = WhitenedSupport::Fit(Walks(60));
  core::Random random(3);
  std::vector<double> z(2), d(2), there(2), gradient(2);
  for (int i = 0; i < 5000; ++i) {
    const int t = static_cast<int>(random.Below(10));
    double square = 0.0, along = 0.0;
    for (double& entry : z) entry = random.Uniform(-2.0, 12.0);
    const double l = support.LogDecision(t, z, gradient);
    for (std::size_t k = 0; k < 2; ++k) {
      d[k] = std::pow(10.0, random.Uniform(-3.0, 0.7)) * random.Normal();
      there[k] = z[k] + d[k];
      square += d[k] * d[k];
      along += d[k] * gradient[k];
    }
    const double bound = l + along - support.curvature_bound(t) * square;
    // Rounding is relative to the added terms.
    ASSERT_GE(support.LogDecision(t, there, {}), bound - 1e-12 * (1.0 + std::abs(l) + square));
  }
}

TEST(WhitenedSupportTest, PhaseWhiteningMakesTheMapsFollowTheSpread) {
  const auto support = WhitenedSupport::Fit(Walks(60));
  // The spread of y grows along the walk, and the map's scale of y falls.
  EXPECT_LT(support.map(8)(1, 1), 0.8 * support.map(1)(1, 1));
  const auto plain = WhitenedSupport::Fit(Walks(60), {.phase_whitening = false});
  EXPECT_TRUE(plain.map(4).isIdentity(0.0));
  EXPECT_EQ(plain.curvature_bound(4), plain.estimate(4).gamma());
}

TEST(WhitenedSupportTest, HoldingEndedDemonstrationsKeepsMoreGoalsInside) {
  const auto walks = Walks(60);
  Eigen::Index longest = 0;
  for (const auto& walk : walks) longest = std::max(longest, walk.rows());
  const auto held = WhitenedSupport::Fit(walks, {.least_share = 0.0});
  EXPECT_EQ(held.num_steps(), longest);
  const auto share = [&](const WhitenedSupport& support) {
    int inside = 0;
    for (const auto& walk : walks) {
      const auto last = core::Row(walk, walk.rows() - 1);
      inside += support.Decision(support.num_steps() - 1, last) >= 0.0 ? 1 : 0;
    }
    return inside;
  };
  EXPECT_GT(share(held),
            share(WhitenedSupport::Fit(walks, {.hold_ended = false, .least_share = 0.0})));
}

// Returns a demonstration of one-entry states for each of `lengths`.
std::vector<core::Matrix> OfLengths(const std::vector<int>& lengths) {
  core::Random random(5);
  std::vector<core::Matrix> demonstrations;
  for (const int length : lengths) {
    core::Matrix states(length, 1);
    for (double& entry : states.reshaped()) entry = random.Normal();
    demonstrations.push_back(states);
  }
  return demonstrations;
}

TEST(WhitenedSupportTest, LastsAsLongAsTheGivenShareOfDemonstrations) {
  const auto steps = [](double share) {
    return WhitenedSupport::Fit(OfLengths({5, 11, 7, 9}), {.least_share = share}).num_steps();
  };
  EXPECT_EQ(steps(0.0), 9) << "at least two demonstrations";
  EXPECT_EQ(steps(0.5), 9);
  EXPECT_EQ(steps(0.51), 7);
  EXPECT_EQ(steps(0.75), 7);
  EXPECT_EQ(steps(1.0), 5);
}

TEST(WhitenedSupportTest, AnEstimateIsFittedToTheStatesOfItsWindow) {
  // LIBSVM's scale is nu times the number of samples.
  const auto states = [](const std::vector<int>& lengths, int t, WhitenedSupportOptions options) {
    options.svm.nu = 0.5;
    const auto support = WhitenedSupport::Fit(OfLengths(lengths), options);
    return std::lround(support.estimate(t).libsvm_scale() / 0.5);
  };
  const std::vector<int> same = {10, 10, 10, 10};
  EXPECT_EQ(states(same, 0, {}), 4 * 3);
  EXPECT_EQ(states(same, 1, {}), 4 * 4);
  EXPECT_EQ(states(same, 5, {}), 4 * 5);
  EXPECT_EQ(states(same, 9, {}), 4 * 3);
  EXPECT_EQ(states(same, 5, {.window = 0}), 4);
  // The window has every second time step: 1, 3, 5, 7, 9 around 5, and 0, 2, 4, 6 around 2.
  EXPECT_EQ(states(same, 5, {.window_share = 0.4}), 4 * 5);
  EXPECT_EQ(states(same, 2, {.window_share = 0.4}), 4 * 4);
  // The window of time step 9 begins at 7. It contains one state of a demonstration of 8 states. A
  // demonstration of 7 states has ended and counts once, with its last state.
  EXPECT_EQ(states({10, 10, 10, 8}, 9, {}), 3 * 3 + 1);
  EXPECT_EQ(states({10, 10, 10, 7}, 9, {}), 3 * 3 + 1);
  EXPECT_EQ(states({10, 10, 10, 8}, 9, {.hold_ended = false}), 3 * 3 + 1);
  EXPECT_EQ(states({10, 10, 10, 7}, 9, {.hold_ended = false}), 3 * 3);
}

TEST(WhitenedSupportTest, TheStrideOfAWindowFollowsItsShare) {
  EXPECT_EQ(WhitenedSupportOptions().Stride(30), 1);
  EXPECT_EQ((WhitenedSupportOptions{.window = 2, .window_share = 0.04}.Stride(99)), 1);
  EXPECT_EQ((WhitenedSupportOptions{.window = 2, .window_share = 0.04}.Stride(100)), 2);
  EXPECT_EQ((WhitenedSupportOptions{.window = 0, .window_share = 0.1}.Stride(100)), 10);
  EXPECT_EQ((WhitenedSupportOptions{.window = 2, .window_share = 0.0}.Stride(10000)), 1);
}

// Returns demonstrations along x that pass an obstacle on either side or, if `aside` is 0, all stay
// near y = 0.
std::vector<core::Matrix> Passing(double aside) {
  core::Random random(4);
  std::vector<core::Matrix> demonstrations;
  for (int d = 0; d < 40; ++d) {
    core::Matrix states(21, 2);
    for (int t = 0; t <= 20; ++t) {
      const double share = t / 20.0;
      const double bend = aside * std::sin(std::numbers::pi * share);
      states.row(t) << 20.0 * share + 0.1 * random.Normal(),
          (d % 2 == 0 ? bend : -bend) + 0.2 * random.Normal();
    }
    demonstrations.push_back(states);
  }
  return demonstrations;
}

TEST(WhitenedSupportTest, TheGapBetweenTwoWaysIsFound) {
  const auto ways = Passing(3.0);
  const ModeSeparationTest tight = TestModeSeparation(WhitenedSupport::Fit(ways), ways);
  EXPECT_EQ(tight.steps, 21);
  // The paths meet at the ends. At nine time steps they are more than 4.8 apart.
  EXPECT_GE(tight.points, 9);
  EXPECT_LE(tight.points, 15);
  EXPECT_EQ(tight.inside, 0);
  const auto wide = WhitenedSupport::Fit(ways, {.svm = {.nu = 0.05, .gamma = 0.002}});
  const ModeSeparationTest loose = TestModeSeparation(wide, ways);
  EXPECT_EQ(loose.inside, loose.points) << "one cloud for both ways";
  // With one path there is no gap.
  const auto way = Passing(0.0);
  EXPECT_LE(TestModeSeparation(WhitenedSupport::Fit(way), way).points, 2);
  EXPECT_THROW((void)TestModeSeparation(wide, std::vector<core::Matrix>{core::Matrix::Zero(3, 3)}),
               std::invalid_argument);
}

// Tests one time step, whose support is a ball of radius .83 about `center`. `later` is the next
// state of each demonstration. Its time step has no separate estimate.
ModeSeparationTest Gaps(const std::vector<double>& states, double center, double later = -100.0) {
  std::vector<core::Matrix> demonstrations;
  for (const double state : states) {
    core::Matrix rows(2, 1);
    rows << state, later;
    demonstrations.push_back(rows);
  }
  const WhitenedSupport support(
      {{core::Matrix::Identity(1, 1), OneClassSvm::FromParts(core::Matrix::Constant(1, 1, center),
                                                             Eigen::VectorXd::Ones(1), 1.0, 0.5)}});
  return TestModeSeparation(support, demonstrations);
}

TEST(WhitenedSupportTest, AGapIsTheMiddleBetweenClustersOfThreeThatAreFourApart) {
  // 5.1 is in the middle of the gap.
  const std::vector<double> apart = {0.0, 0.1, 0.2, 10.0, 10.1, 10.2};
  EXPECT_EQ(Gaps(apart, 5.1).steps, 1);
  EXPECT_EQ(Gaps(apart, 5.1).points, 1);
  EXPECT_EQ(Gaps(apart, 5.1).inside, 1);
  EXPECT_EQ(Gaps(apart, 5.9).inside, 1);
  EXPECT_EQ(Gaps(apart, 6.0).inside, 0);
  EXPECT_EQ(Gaps(apart, 0.1).inside, 0);
  EXPECT_EQ(Gaps({0.0, 0.1, 0.2, 4.1, 4.2, 4.3}, 0.0).points, 0) << "3.9 apart";
  EXPECT_EQ(Gaps({0.0, 0.1, 0.2, 4.3, 4.4, 4.5}, 0.0).points, 1) << "4.1 apart";
  EXPECT_EQ(Gaps({0.0, 0.1, 0.2, 0.3, 10.0, 10.1}, 0.0).points, 0)
      << "two states are not a cluster";
  // A demonstration passes later, within 2.45 (a quarter of the gap) of the middle.
  EXPECT_EQ(Gaps(apart, 0.0, 5.1 + 2.4).points, 0);
  EXPECT_EQ(Gaps(apart, 0.0, 5.1 + 2.5).points, 1);
  // With 40 demonstrations a cluster needs a tenth of them: four.
  std::vector<double> many;
  many.reserve(40);
  for (int i = 0; i < 37; ++i) many.push_back(0.1 * i);
  for (int i = 0; i < 3; ++i) many.push_back(20.0 + 0.1 * i);
  EXPECT_EQ(Gaps(many, 0.0).points, 0);
  many[0] = 20.3;
  EXPECT_EQ(Gaps(many, 0.0).points, 1);
}

// Returns positions in a ring of radii 1 and 2, at three time steps.
std::vector<core::Matrix> Rings(int count) {
  core::Random random(3);
  std::vector<core::Matrix> rings;
  while (std::ssize(rings) < count) {
    const double x = random.Uniform(-2.0, 2.0);
    const double y = random.Uniform(-2.0, 2.0);
    const double radius = std::hypot(x, y);
    if (radius < 1.0 || radius > 2.0) continue;
    core::Matrix states(3, 2);
    for (int t = 0; t < 3; ++t) states.row(t) << x, y;
    rings.push_back(states);
  }
  return rings;
}

TEST(WhitenedSupportTest, TheVolumeRatioAgreesWithAreasOnAGrid) {
  const std::vector<core::Matrix> rings = Rings(80);
  const auto fit = [&](double gamma) {
    return WhitenedSupport::Fit(rings, {.svm = {.gamma = gamma}, .phase_whitening = false});
  };
  const auto area = [&](const WhitenedSupport& support, double level) {
    int inside = 0;
    for (int i = 0; i < 140 * 140; ++i) {
      const std::vector<double> z = {0.05 * (i % 140 - 70), 0.05 * (i / 140 - 70)};  // NOLINT
      inside += support.LogDecision(1, z, {}) >= level ? 1 : 0;
    }
    return inside;
  };
  const WhitenedSupport wide = fit(1.0);
  const WhitenedSupport narrow = fit(4.0);
  for (const double level : {0.0, -0.3}) {
    const double expected = std::log(static_cast<double>(area(narrow, level)) / area(wide, level));
    EXPECT_LT(expected, -0.1);
    EXPECT_NEAR(LogVolumeRatio(wide, level, narrow, level, rings), expected, 0.1) << level;
  }
  EXPECT_EQ(LogVolumeRatio(wide, 0.0, wide, 0.0, rings), 0.0);
  EXPECT_EQ(LogVolumeRatio(wide, 0.0, narrow, 0.0, std::span(rings).first(4)), 0.0);
}

TEST(WhitenedSupportTest, ACoarseSupportHasEveryFourthEstimate) {
  const std::vector<core::Matrix> walks = Walks(20);
  const auto fine = WhitenedSupport::Fit(walks);
  const auto coarse = WhitenedSupport::Fit(walks, {.every = 4});
  ASSERT_EQ(coarse.num_steps(), (fine.num_steps() + 3) / 4);
  for (int t = 0; t < coarse.num_steps(); ++t) {
    const std::vector<double> z = {4.0 * t, 0.2};
    EXPECT_EQ(coarse.LogDecision(t, z, {}), fine.LogDecision(4 * t, z, {}));
  }
}

// A map of many features takes long to compute: after Ctrl-C, a fit does not compute the maps of
// the remaining time steps.
TEST(WhitenedSupportTest, AStoppedFitEndsWithItsTimeStep) {
  const std::vector<core::Matrix> demonstrations = Walks(20);
  WhitenedSupportOptions options;
  const int all = WhitenedSupport::Fit(demonstrations, options).num_steps();
  bool stops = false;
  int calls = 0;
  options.svm.progress = [&](const FitProgress&) { return ++calls > 0 && !stops; };
  EXPECT_EQ(WhitenedSupport::Fit(demonstrations, options).num_steps(), all);
  EXPECT_GE(calls, all);
  stops = true;
  EXPECT_EQ(WhitenedSupport::Fit(demonstrations, options).num_steps(), 1);
}

TEST(WhitenedSupportTest, NoEstimateFollowsAStoppedOne) {
  const std::vector<core::Matrix> demonstrations = Walks(20);
  WhitenedSupportOptions options;
  int calls = 0;
  int last = 0;
  options.svm.progress = [&](const FitProgress& p) {
    EXPECT_GT(p.tolerance, 0.0);
    return ++calls != last;
  };
  const int all = WhitenedSupport::Fit(demonstrations, options).num_steps();
  const int all_calls = calls;
  ASSERT_GT(all_calls, all) << "a fit calls, too";
  for (last = 1; last < all_calls; last += 7) {
    calls = 0;
    EXPECT_LE(WhitenedSupport::Fit(demonstrations, options).num_steps(), all);
    EXPECT_EQ(calls, last) << "called again after the stop";
  }
}

TEST(WhitenedSupportTest, BrokenSensorsReadAsOutsideAndNothingAllocates) {
  const auto support = WhitenedSupport::Fit(Walks(30));
  std::vector<double> gradient(2);
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const std::vector<double> broken = {0.0, std::nan("")};
  EXPECT_EQ(support.Decision(1, broken), -kInfinity);
  EXPECT_EQ(support.LogDecision(1, broken, gradient), -kInfinity);
  EXPECT_EQ(gradient, std::vector<double>(2, 0.0));
  EXPECT_EQ(support.LogDecision(1, std::vector{1.0}, {}), -kInfinity);
  EXPECT_EQ(support.Decision(1, std::vector{1.0}), -kInfinity);
  const std::vector<double> z = {1.0, 0.0};
  std::vector<double> wide(3, 7.0);
  EXPECT_EQ(support.Gradient(1, z, wide), -kInfinity);
  EXPECT_EQ(wide, std::vector<double>(3, 0.0));
  wide.assign(3, 7.0);
  EXPECT_EQ(support.LogDecision(1, z, wide), -kInfinity);
  EXPECT_EQ(wide, std::vector<double>(3, 0.0));
  EXPECT_EQ(support.Gradient(1, std::vector<double>(3), wide), -kInfinity);
  const dfr::test::NoAlloc guard;
  (void)support.Decision(1, z);
  (void)support.Gradient(1, z, gradient);
  (void)support.LogDecision(1, z, gradient);
}

TEST(WhitenedSupportTest, InvalidArgumentsAreRefused) {
  const auto walks = Walks(5);
  for (const WhitenedSupportOptions& options : {WhitenedSupportOptions{.window = -1},
                                                {.phase_ridge = 0.0},
                                                {.least_share = 1.5},
                                                {.least_share = -0.1},
                                                {.window_share = -0.1},
                                                {.window_share = 1.1},
                                                {.every = 0}}) {
    EXPECT_THROW(WhitenedSupport::Fit(walks, options), std::invalid_argument);
  }
  EXPECT_NO_THROW(WhitenedSupport::Fit(walks, {.window_share = 1.0}));
  EXPECT_THROW(WhitenedSupport::Fit(std::vector{walks[0]}), std::invalid_argument);
  auto broken = walks;
  broken[2](1, 1) = std::nan("");
  EXPECT_THROW(WhitenedSupport::Fit(broken), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::kernel
