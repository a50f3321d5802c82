#include "dfr/experiment/intervals.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"

namespace dfr::experiment {
namespace {

// Binomial probability by its definition, for small n.
double Probability(int k, int n, double p) {
  double choose = 1.0;
  for (int i = 1; i <= k; ++i) choose *= (n - i + 1.0) / i;
  return choose * std::pow(p, k) * std::pow(1.0 - p, n - k);
}

void ExpectInterval(Interval interval, double low, double high, double tolerance) {
  EXPECT_NEAR(interval.low, low, tolerance);
  EXPECT_NEAR(interval.high, high, tolerance);
}

// Tolerances are half of the last digit that the sources print.
TEST(IntervalsTest, AgreeWithPublishedValues) {
  ExpectInterval(ClopperPearsonInterval(0, 60), 0.0, 0.0596, 5e-5);
  ExpectInterval(WilsonInterval(0, 60), 0.0, 0.0602, 5e-5);
  ExpectInterval(ClopperPearsonInterval(0, 600), 0.0, 0.0061, 5e-5);
  ExpectInterval(WilsonInterval(30, 600), 0.0352, 0.0705, 5e-5);
  // R 4: binom.test(5, 10), (1, 10), (10, 100).
  ExpectInterval(ClopperPearsonInterval(5, 10), 0.1870860, 0.8129140, 5e-8);
  ExpectInterval(ClopperPearsonInterval(1, 10), 0.002528579, 0.4450161, 5e-8);
  ExpectInterval(ClopperPearsonInterval(10, 100), 0.04900469, 0.1762226, 5e-8);
}

TEST(IntervalsTest, WilsonEndsSolveTheScoreEquation) {
  // (p - k/n)^2 = z^2 p (1 - p) / n at both ends, z the 97.5 % quantile of the normal law.
  constexpr double kZ = 1.959963984540054;
  for (const int k : {1, 7, 40, 59}) {
    const Interval interval = WilsonInterval(k, 60);
    for (const double p : {interval.low, interval.high}) {
      EXPECT_NEAR(std::abs(p - k / 60.0), kZ * std::sqrt(p * (1.0 - p) / 60.0), 1e-13) << k;
    }
  }
}

TEST(IntervalsTest, ClopperPearsonEndsHaveTheirTails) {
  constexpr int kTrials = 25;
  for (const double confidence : {0.8, 0.95, 0.999}) {
    for (int k = 0; k <= kTrials; ++k) {
      const Interval interval = ClopperPearsonInterval(k, kTrials, confidence);
      double above = 0.0;
      double below = 0.0;
      for (int i = k; i <= kTrials; ++i) above += Probability(i, kTrials, interval.low);
      for (int i = 0; i <= k; ++i) below += Probability(i, kTrials, interval.high);
      const double tail = 0.5 * (1.0 - confidence);
      // Allows for sums of up to 26 rounded powers.
      if (k > 0) {
        EXPECT_NEAR(above, tail, 1e-12) << k;
      }
      if (k < kTrials) {
        EXPECT_NEAR(below, tail, 1e-12) << k;
      }
    }
  }
}

TEST(IntervalsTest, ClopperPearsonCoversEveryProportion) {
  constexpr int kTrials = 30;
  for (int i = 1; i < 200; ++i) {
    const double p = i / 200.0;
    double coverage = 0.0;
    for (int k = 0; k <= kTrials; ++k) {
      const Interval interval = ClopperPearsonInterval(k, kTrials);
      if (interval.low <= p && p <= interval.high) coverage += Probability(k, kTrials, p);
    }
    EXPECT_GE(coverage, 0.95) << p;
  }
}

TEST(IntervalsTest, ProportionsOfFewEventsUseClopperPearson) {
  for (const int few : {0, 4, 56, 60}) {
    EXPECT_EQ(ProportionInterval(few, 60).high, ClopperPearsonInterval(few, 60).high) << few;
  }
  for (const int many : {5, 30, 55}) {
    EXPECT_EQ(ProportionInterval(many, 60).high, WilsonInterval(many, 60).high) << many;
  }
}

TEST(IntervalsTest, LargeCountsNeitherOverflowNorStall) {
  const Interval interval = ClopperPearsonInterval(50'000, 100'000);
  // The normal law is exact here to 1e-5.
  ExpectInterval(interval, 0.5 - 1.96 * 0.5 / std::sqrt(1e5), 0.5 + 1.96 * 0.5 / std::sqrt(1e5),
                 1e-5);
}

TEST(IntervalsTest, RefuseCountsThatDoNotFit) {
  EXPECT_THROW((void)WilsonInterval(1, 0), std::invalid_argument);
  EXPECT_THROW((void)WilsonInterval(3, 2), std::invalid_argument);
  EXPECT_THROW((void)ClopperPearsonInterval(-1, 2), std::invalid_argument);
  EXPECT_THROW((void)ClopperPearsonInterval(1, 2, 1.0), std::invalid_argument);
}

// By hand: p = .35, v = (4 + 4 + 25 + 25) 5/4 / 100^2, t quantiles 1.98422 and 2.77645 of the
// tables for 99 and 4 degrees of freedom: 16.027 effective episodes of 100.
TEST(ClusteredTest, IsKornAndGraubards) {
  const std::vector<ClusterCount> trials = {{5, 20}, {9, 20}, {2, 20}, {12, 20}, {7, 20}};
  ExpectInterval(ClusteredInterval(trials), 0.134931, 0.622233, 2e-5);
}

TEST(ClusteredTest, IsClopperPearsonWhereTrialsDoNotDiffer) {
  const Interval ten = ClopperPearsonInterval(10, 40);
  ExpectInterval(ClusteredInterval(std::vector<ClusterCount>{{5, 20}, {5, 20}}), ten.low, ten.high,
                 1e-12);
  ExpectInterval(ClusteredInterval(std::vector<ClusterCount>{{10, 40}, {0, 0}}), ten.low, ten.high,
                 1e-12);
  const Interval none = ClusteredInterval(std::vector<ClusterCount>(10, {0, 1200}));
  EXPECT_EQ(none.low, 0.0);
  EXPECT_NEAR(none.high, 1.0 - std::pow(0.025, 1.0 / 12'000), 1e-12);
  EXPECT_THROW((void)ClusteredInterval({}), std::invalid_argument);
}

// Trials have different rates. Intervals that treat episodes as independent cover the mean rate too
// rarely.
TEST(ClusteredTest, CoversWhenTrialsDiffer) {
  constexpr int kRepetitions = 400;
  int covered = 0;
  int covered_as_if_independent = 0;
  for (int repetition = 0; repetition < kRepetitions; ++repetition) {
    core::Random random(core::DeriveSeed(12, {static_cast<std::uint64_t>(repetition)}));
    std::vector<ClusterCount> trials(10);
    int successes = 0;
    for (ClusterCount& trial : trials) {
      const double rate = random.Uniform(0.1, 0.7);
      for (int i = 0; i < 60; ++i) trial.successes += random.Uniform() < rate ? 1 : 0;
      trial.episodes = 60;
      successes += trial.successes;
    }
    const Interval clustered = ClusteredInterval(trials);
    const Interval independent = ProportionInterval(successes, 600);
    covered += clustered.low <= 0.4 && 0.4 <= clustered.high ? 1 : 0;
    covered_as_if_independent += independent.low <= 0.4 && 0.4 <= independent.high ? 1 : 0;
  }
  // .95 minus four standard errors of 400 repetitions
  EXPECT_GT(covered, 0.90 * kRepetitions);
  EXPECT_LT(covered_as_if_independent, 0.75 * kRepetitions);
}

TEST(RateRatioTest, HasTheOddsOfClopperPearson) {
  for (const int events : {0, 1, 7}) {
    const Interval share = ClopperPearsonInterval(events, events + 40);
    ExpectInterval(RateRatioInterval(events, 40), share.low / (1.0 - share.low),
                   share.high / (1.0 - share.high), 1e-12);
  }
  EXPECT_THROW((void)RateRatioInterval(1, 0), std::invalid_argument);
}

TEST(PowerTest, IsConnorsFormula) {
  // (1.959964 sqrt(.2) + .841621 sqrt(.2 - .01))^2 / .01 = 154.6
  EXPECT_EQ(EpisodesForDifference(0.05, 0.15), 155);
  EXPECT_EQ(EpisodesForDifference(0.15, 0.05), 155);
  EXPECT_GT(EpisodesForDifference(0.05, 0.15, 0.9), 155);
  EXPECT_THROW((void)EpisodesForDifference(0.1, 0.1), std::invalid_argument);
  EXPECT_THROW((void)EpisodesForDifference(0.6, 0.5), std::invalid_argument);
}

TEST(PowerTest, NumbersThatMeanNothingAreRefused) {
  for (const double wrong : {-0.5, 0.0, 1.0, 1.5, std::nan("")}) {
    EXPECT_THROW((void)WilsonInterval(1, 4, wrong), std::invalid_argument);
    EXPECT_THROW((void)RateRatioInterval(1, 4, wrong), std::invalid_argument);
    EXPECT_THROW((void)EpisodesForDifference(0.05, 0.15, 0.8, wrong), std::invalid_argument);
    EXPECT_THROW((void)EpisodesForDifference(0.05, 0.15, wrong), std::invalid_argument);
    EXPECT_THROW((void)EpisodesForBound(0.01, wrong), std::invalid_argument);
    EXPECT_THROW((void)EpisodesForBound(wrong), std::invalid_argument);
  }
  // These numbers of episodes exceed the range of int.
  EXPECT_THROW((void)EpisodesForBound(1e-12), std::invalid_argument);
  EXPECT_THROW((void)EpisodesForDifference(0.05, 0.05 + 1e-9), std::invalid_argument);
}

// The share of exact McNemar tests that find the difference is the power of the formula.
TEST(PowerTest, McNemarsTestHasThePower) {
  const int episodes = EpisodesForDifference(0.05, 0.15);
  core::Random random(3);
  int found = 0;
  for (int repetition = 0; repetition < 2000; ++repetition) {
    std::vector<DiscordantPairs> pairs;
    for (int i = 0; i < episodes; ++i) {
      const double u = random.Uniform();
      if (u < 0.20) pairs.push_back({u < 0.05 ? 1 : 0, u < 0.05 ? 0 : 1});
    }
    found += ClusteredMcNemar(pairs) < 0.05 ? 1 : 0;
  }
  // The exact test is conservative and therefore has slightly less power.
  EXPECT_GT(found, 0.72 * 2000);
  EXPECT_LT(found, 0.84 * 2000);
}

TEST(PowerTest, ABoundNeedsAsManyEpisodesAsClopperPearsonDoes) {
  for (const double bound : {0.05, 0.005, 0.0003}) {
    const int episodes = EpisodesForBound(bound);
    EXPECT_LE(ClopperPearsonInterval(0, episodes).high, bound);
    EXPECT_GT(ClopperPearsonInterval(0, episodes - 1).high, bound);
  }
  EXPECT_EQ(EpisodesForBound(0.0003), 12'295);
}

// Fisher (The Design of Experiments, sec. 21) on Darwin's maize: of the 32 768 sign patterns of 15
// differences, 863 give a sum of at least 314, and 863 a sum of at most -314.
TEST(ClusteredMcNemarTest, AgreesWithFishersArrangements) {
  std::vector<DiscordantPairs> clusters;
  for (const int d : {49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48}) {
    clusters.push_back({d > 0 ? d + 3 : 3, d > 0 ? 3 : 3 - d});
  }
  EXPECT_NEAR(ClusteredMcNemar(clusters), 2.0 * 863 / 32768, 1e-12);
}

TEST(ClusteredMcNemarTest, WithOnePairAClusterItIsMcNemarsTest) {
  std::vector<DiscordantPairs> clusters(10, {1, 0});
  clusters.insert(clusters.end(), 2, {0, 1});
  clusters.insert(clusters.end(), 40, {0, 0});
  EXPECT_NEAR(ClusteredMcNemar(clusters), 2.0 * (1 + 12 + 66) / 4096.0, 1e-12);
  EXPECT_EQ(ClusteredMcNemar({}), 1.0);
}

// One bad trial of five is not evidence, for any number of pairs.
TEST(ClusteredMcNemarTest, PairsOfOneClusterAreNotIndependent) {
  const std::vector<DiscordantPairs> one = {{40, 0}, {0, 0}, {0, 0}, {0, 0}, {0, 0}};
  EXPECT_EQ(ClusteredMcNemar(one), 1.0);
  const std::vector<DiscordantPairs> all = {{9, 1}, {8, 0}, {8, 2}, {7, 0}, {8, 1}};
  EXPECT_EQ(ClusteredMcNemar(all), 2.0 / 32.0);
  const std::vector<DiscordantPairs> bad = {{1, -1}};
  EXPECT_THROW((void)ClusteredMcNemar(bad), std::invalid_argument);
}

TEST(ContrastTest, RatiosAreThoseOfTheTotals) {
  const std::vector<PairedCounts> units = {
      {60, 20, 1, 40, 10, 0}, {60, 30, 2, 40, 20, 0}, {60, 10, 0, 40, 0, 0}};
  const PairedContrast contrast = EstimateContrast(units);
  EXPECT_NEAR(contrast.collision_reduction.value(), 1.0 - 3.0 / 30.0, 1e-15);
  EXPECT_NEAR(contrast.completion_ratio.value(), 60.0 / 120.0, 1e-15);
  EXPECT_LE(contrast.completion_ratio_interval.value().low, 0.5);
  EXPECT_GE(contrast.completion_ratio_interval.value().high, 0.5);
}

TEST(ContrastTest, UndefinedRatiosAreAbsent) {
  const std::vector<PairedCounts> no_collisions = {{60, 20, 1, 40, 0, 0}, {60, 20, 1, 40, 0, 0}};
  const PairedContrast contrast = EstimateContrast(no_collisions);
  EXPECT_FALSE(contrast.collision_reduction);
  EXPECT_FALSE(contrast.collision_reduction_interval);
  EXPECT_TRUE(contrast.completion_ratio_interval);
  const std::vector<PairedCounts> one_trial = {{60, 20, 1, 40, 10, 0}};
  EXPECT_TRUE(EstimateContrast(one_trial).collision_reduction);
  EXPECT_FALSE(EstimateContrast(one_trial).collision_reduction_interval);
  // Each unit is a separate stratum: there is nothing to resample.
  const std::vector<PairedCounts> strata = {{60, 20, 1, 40, 10, 0}, {60, 20, 1, 40, 10, 1}};
  EXPECT_FALSE(EstimateContrast(strata).collision_reduction_interval);
}

// The true rate of collisions can be positive although no collision was observed.
TEST(ContrastTest, ZeroCollisionsHaveAnExactBound) {
  const std::vector<PairedCounts> units(5, {60, 20, 0, 40, 10, 0});
  const Interval interval = EstimateContrast(units).collision_reduction_interval.value();
  EXPECT_EQ(interval.high, 1.0);
  const double share = 1.0 - std::pow(0.025, 1.0 / 50);
  EXPECT_NEAR(interval.low, 1.0 - share / (1.0 - share), 1e-12);
  // If the reference's collisions occur in clusters, they have less weight.
  std::vector<PairedCounts> uneven = units;
  uneven[0].reference_collided = 40;
  for (std::size_t i = 1; i < 5; ++i) uneven[i].reference_collided = i == 1 ? 10 : 0;
  EXPECT_LT(EstimateContrast(uneven).collision_reduction_interval.value().low, interval.low);
}

// A few episodes without variation are no proof of a ratio.
TEST(ContrastTest, AnIntervalOfCompletionsIsNeverAPoint) {
  const std::vector<PairedCounts> none(5, {60, 0, 0, 40, 10, 0});
  const Interval of_none = EstimateContrast(none).completion_ratio_interval.value();
  EXPECT_EQ(of_none.low, 0.0);
  const double share = 1.0 - std::pow(0.025, 1.0 / 200);
  EXPECT_NEAR(of_none.high, share / (1.0 - share), 1e-12);
  std::vector<PairedCounts> equal;
  for (const int n : {3, 5, 4, 4, 5}) equal.push_back({60, n, 0, n, 10, 0});
  for (const auto& units : {equal, std::vector<PairedCounts>(5, equal[0])}) {
    const Interval same = EstimateContrast(units).completion_ratio_interval.value();
    EXPECT_LT(same.low, 0.9);
    EXPECT_GT(same.high, 1.1);
  }
}

TEST(RatioTest, UnitsVaryAboutTheirStratum) {
  // Two strata of identical units: nothing varies.
  const std::vector<RatioPart> units = {{1.0, 1.0, 0}, {1.0, 1.0, 0}, {0.0, 1.0, 1}, {0.0, 1.0, 1}};
  ExpectInterval(RatioInterval(units).value(), 0.5, 0.5, 0.0);
}

// By hand: totals 9 and 6, variances 3/2 (1 + 0 + 1) = 3 and 0, t = 4.302653 with 2 degrees of
// freedom: (9 +- 4.302653 sqrt(3)) / 6.
TEST(RatioTest, IsStudentsWhereTheDenominatorIsConstant) {
  const std::vector<RatioPart> units = {{2.0, 2.0}, {3.0, 2.0}, {4.0, 2.0}};
  ExpectInterval(RatioInterval(units).value(), 1.5 - 1.242069, 1.5 + 1.242069, 1e-6);
}

// At both ends r, the t test of numerator - r denominator is critical: |mean| = t s / sqrt(n).
TEST(RatioTest, TheTTestIsCriticalAtBothEnds) {
  const std::vector<RatioPart> units = {
      {5.0, 9.0}, {8.0, 12.0}, {4.0, 10.0}, {9.0, 11.0}, {6.0, 8.0}};
  const Interval interval = RatioInterval(units).value();
  for (const double r : {interval.low, interval.high}) {
    double sum = 0.0;
    double squares = 0.0;
    for (const RatioPart& unit : units) {
      const double residual = unit.numerator - r * unit.denominator;
      sum += residual;
      squares += residual * residual;
    }
    const double variance = (squares - sum * sum / 5.0) / 4.0;
    EXPECT_NEAR(std::abs(sum / 5.0), 2.776445 * std::sqrt(variance / 5.0), 1e-6);
  }
}

TEST(RatioTest, IsAbsentIfItCannotBeEstimated) {
  EXPECT_FALSE(RatioInterval({}));
  EXPECT_FALSE(RatioInterval(std::vector<RatioPart>{{1.0, 2.0}}));
  EXPECT_FALSE(RatioInterval(std::vector<RatioPart>{{1.0, 2.0, 0}, {1.0, 2.0, 1}}));
  // The denominator may be zero.
  EXPECT_FALSE(RatioInterval(std::vector<RatioPart>{{1.0, 0.0}, {1.0, 0.0}, {1.0, 1.0}}));
  EXPECT_THROW((void)RatioInterval({}, 1.0), std::invalid_argument);
}

// Returns the central 95 % of the ratio in resamples of whole units.
Interval PercentileBootstrap(const std::vector<PairedCounts>& units, core::Random& random) {
  constexpr std::size_t kResamples = 200;
  std::vector<double> ratios;
  for (std::size_t i = 0; i < kResamples; ++i) {
    int completed = 0;
    int reference = 0;
    for (std::size_t k = 0; k < units.size(); ++k) {
      const PairedCounts& unit = units[random.Below(units.size())];
      completed += unit.completed;
      reference += unit.reference_completed;
    }
    ratios.push_back(static_cast<double>(completed) / reference);
  }
  std::ranges::sort(ratios);
  return {ratios[kResamples / 40], ratios[kResamples - 1 - kResamples / 40]};
}

// Five different trials with 60 episodes each, as with five supervisors.
TEST(CoverageTest, FiveClustersAreEnoughForTButNotForABootstrap) {
  constexpr int kRepetitions = 2000;
  constexpr double kTrueRatio = 0.4 / 0.6;
  int ratio = 0;
  int proportion = 0;
  int bootstrap = 0;
  for (int repetition = 0; repetition < kRepetitions; ++repetition) {
    core::Random random(core::DeriveSeed(11, {static_cast<std::uint64_t>(repetition)}));
    std::vector<PairedCounts> units(5);
    std::vector<ClusterCount> trials;
    for (PairedCounts& unit : units) {
      const double reference = random.Uniform(0.3, 0.9);
      const double rate = random.Uniform(0.1, 0.7);
      for (int i = 0; i < 60; ++i) {
        ++unit.episodes;
        unit.reference_completed += random.Uniform() < reference ? 1 : 0;
        unit.completed += random.Uniform() < rate ? 1 : 0;
      }
      trials.push_back({unit.completed, unit.episodes});
    }
    const auto covers = [](Interval interval, double value) {
      return interval.low <= value && value <= interval.high ? 1 : 0;
    };
    const auto interval = EstimateContrast(units).completion_ratio_interval;
    ratio += interval ? covers(*interval, kTrueRatio) : 1;
    proportion += covers(ClusteredInterval(trials), 0.4);
    bootstrap += covers(PercentileBootstrap(units, random), kTrueRatio);
  }
  EXPECT_GE(ratio, 0.93 * kRepetitions);
  EXPECT_LE(ratio, 0.98 * kRepetitions);
  EXPECT_GE(proportion, 0.93 * kRepetitions);
  EXPECT_LE(bootstrap, 0.88 * kRepetitions);
}

// The rounding of equal ratios must not count as variation between units.
TEST(EstimateContrastTest, EqualRatiosOfTrialsAreNoExactResult) {
  std::vector<PairedCounts> units;
  for (const int third : {1, 2, 3, 2, 1}) {
    PairedCounts& unit = units.emplace_back();
    unit.episodes = 60;
    unit.completed = 3 * third;
    unit.reference_completed = 10 * third;
  }
  const Interval interval = EstimateContrast(units).completion_ratio_interval.value();
  const Interval exact = RateRatioInterval(27, 90);
  EXPECT_LE(interval.low, exact.low);
  EXPECT_GE(interval.high, exact.high);
}

TEST(AverageCurvesTest, EndedCurvesStayAtTheirLastValue) {
  const std::vector<std::vector<double>> curves = {{0.0, 1.0}, {2.0}, {1.0, 0.0, 3.0}};
  const MeanCurve average = AverageCurves(curves, 3);
  EXPECT_EQ(average.mean, (std::vector{1.0, 1.0, 2.0}));
  // The values 1, 2 and 3 of the last place have the variance 1.
  EXPECT_NEAR(average.standard_error[2], std::sqrt(1.0 / 3.0), 1e-15);
  EXPECT_EQ(AverageCurves({curves.data(), 1}, 2).standard_error, (std::vector{0.0, 0.0}));
  EXPECT_THROW((void)AverageCurves({}, 1), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::experiment
