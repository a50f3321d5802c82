#include "dfr/experiment/sequential_test.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>

#include "dfr/core/random.h"

namespace dfr::experiment {
namespace {

TEST(SequentialTestTest, WealthIsTheMeanOverStakes) {
  SequentialTest test;
  test.Add(1.0);
  EXPECT_NEAR(std::exp(test.log_wealth()), 1.0, 1e-12);  // each stake has an opposite stake
  test.Add(1.0);
  // The mean of (1 + s)^2 is 1 plus the mean of s^2, 2 (.01 + .04 + ... + .81) / 18 = .31666...
  EXPECT_NEAR(std::exp(test.log_wealth()), 1.0 + 5.7 / 18.0, 1e-12);
  EXPECT_EQ(test.mean(), 1.0);
  SequentialTest even;
  even.Add(1.0);
  even.Add(-1.0);
  EXPECT_NEAR(std::exp(even.log_wealth()), 1.0 - 5.7 / 18.0, 1e-12);
  EXPECT_EQ(even.mean(), 0.0);
  EXPECT_EQ(even.p_value(), 1.0);
}

TEST(SequentialTestTest, ASettledQuestionStaysSettled) {
  SequentialTest test(0.05);
  while (!test.settled()) test.Add(-1.0);
  const std::int64_t at = test.pairs();
  // (1.9^n + 1.8^n + ... + .1^n) / 18 is 14.4 for n = 7 and 24.9 for n = 8.
  EXPECT_EQ(at, 8);
  const double p = test.p_value();
  EXPECT_LE(p, 0.05);
  for (int i = 0; i < 50; ++i) test.Add(1.0);
  EXPECT_TRUE(test.settled());
  EXPECT_LE(test.p_value(), p);
  EXPECT_EQ(test.pairs(), at + 50);
}

// Evaluated after every pair, the test declares equal methods different in at most a fraction alpha
// of the runs.
TEST(SequentialTestTest, RepeatedLooksKeepTheErrorRate) {
  constexpr int kRuns = 500;
  constexpr double kAlpha = 0.1;
  int wrong = 0;
  for (std::uint64_t run = 0; run < kRuns; ++run) {
    core::Random random(core::DeriveSeed(71, {run}));
    SequentialTest test(kAlpha);
    for (int i = 0; i < 400; ++i) {
      const double u = random.Uniform();
      test.Add(u < 0.2 ? 0.5 : u < 0.3 ? 1.0 : u < 0.6 ? 0.0 : u < 0.7 ? -1.0 : u < 0.9 ? -0.5 : 0);
    }
    wrong += test.settled() ? 1 : 0;
  }
  EXPECT_LE(wrong, kRuns * kAlpha + 3.0 * std::sqrt(kRuns * kAlpha * (1.0 - kAlpha)));
}

TEST(SequentialTestTest, OptionsOutOfRangeAreRefused) {
  SequentialTest test;
  EXPECT_THROW(test.Add(1.5), std::invalid_argument);
  EXPECT_THROW(test.Add(std::numeric_limits<double>::quiet_NaN()), std::invalid_argument);
  EXPECT_THROW(SequentialTest(0.0), std::invalid_argument);
  EXPECT_EQ(test.pairs(), 0);
}

TEST(EpisodeCreditTest, RanksOutcomesAndHaltsByTheirProgress) {
  const EpisodeCredit credit;
  EXPECT_EQ(credit(core::Outcome::kCompleted, 0.9), 1.0);
  EXPECT_EQ(credit(core::Outcome::kHalted, 1.0), 0.5);
  EXPECT_EQ(credit(core::Outcome::kHalted, 0.5), 0.25);
  EXPECT_EQ(credit(core::Outcome::kHalted, 0.0), 0.0);
  EXPECT_EQ(credit(core::Outcome::kCollided, 0.9), 0.0);
}

}  // namespace
}  // namespace dfr::experiment
