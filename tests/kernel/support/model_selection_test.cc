#include "dfr/kernel/model_selection.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "support/fit_sharing.h"
#include "support/states_at.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"

namespace dfr::kernel {
namespace {

using testing::HasSubstr;

// Offsets between demonstrations are much larger than the noise within one.
std::vector<core::Matrix> Demonstrations(int count, std::uint64_t seed) {
  core::Random random(seed);
  std::vector<core::Matrix> all;
  for (int d = 0; d < count; ++d) {
    const double offset = random.Normal();
    core::Matrix states(10, 2);
    for (Eigen::Index t = 0; t < 10; ++t) {
      states.row(t) << 0.3 * static_cast<double>(t) + offset + 0.05 * random.Normal(),
          0.5 * offset + 0.05 * random.Normal();
    }
    all.push_back(states);
  }
  return all;
}

TEST(ConformalThresholdTest, IsTheScoreOfRankCeilNPlusOneTimesOneMinusAlpha) {
  const std::vector<double> scores = {5, 1, 4, 2, 3, 9, 8, 7, 6};  // n = 9
  EXPECT_EQ(ConformalThreshold(scores, 0.1), 9.0);                 // rank 9
  EXPECT_EQ(ConformalThreshold(scores, 0.2), 8.0);                 // rank 8
  EXPECT_EQ(ConformalThreshold(scores, 0.25), 8.0);                // rank ceil(7.5)
  EXPECT_EQ(ConformalThreshold(scores, 0.5), 5.0);
  EXPECT_EQ(ConformalThreshold(scores, 0.99), 1.0);
  // Nine scores cannot guarantee less than one alarm in ten.
  EXPECT_EQ(ConformalThreshold(scores, 0.09), std::numeric_limits<double>::infinity());
}

// A new score exceeds the threshold with a probability of at most alpha, and not much less.
TEST(ConformalThresholdTest, NewScoresExceedItAsOftenAsPromised) {
  core::Random random(61);
  constexpr int kTrials = 5000;
  int exceeded = 0;
  std::vector<double> scores(39);
  for (int trial = 0; trial < kTrials; ++trial) {
    for (double& s : scores) s = random.Normal();
    exceeded += random.Normal() > ConformalThreshold(scores, 0.1) ? 1 : 0;
  }
  // Rank 36 of 39 gives exactly a tenth, within four standard errors.
  EXPECT_NEAR(exceeded / static_cast<double>(kTrials), 0.1, 4.0 * std::sqrt(0.1 * 0.9 / kTrials));
}

// The rank k is the smallest with P(Binomial(n, 1 - alpha) <= k - 1) >= confidence.
TEST(ConformalThresholdTest, WithAConfidenceThePromiseHoldsForThatShareOfSets) {
  constexpr double kNone = std::numeric_limits<double>::infinity();
  const std::vector<double> scores = {5, 1, 4, 2, 3, 9, 8, 7, 6};
  // Nine fair coins show at most 4, 5, 6, 7, 8 heads in 256, 382, 466, 502, 511 of 512 cases.
  EXPECT_EQ(ConformalThreshold(scores, 0.5, 0.49), 5.0);
  EXPECT_EQ(ConformalThreshold(scores, 0.5, 0.51), 6.0);
  EXPECT_EQ(ConformalThreshold(scores, 0.5, 0.90), 7.0);
  EXPECT_EQ(ConformalThreshold(scores, 0.5, 0.95), 8.0);
  EXPECT_EQ(ConformalThreshold(scores, 0.5, 0.99), 9.0);
  EXPECT_EQ(ConformalThreshold(scores, 0.5, 0.999), kNone);
  // Nine coins that show heads three times in four show at most 6, 7, 8 heads in 40, 70, 92 % of
  // cases.
  EXPECT_EQ(ConformalThreshold(scores, 0.25, 0.3), 7.0);
  EXPECT_EQ(ConformalThreshold(scores, 0.25, 0.5), 8.0);
  EXPECT_EQ(ConformalThreshold(scores, 0.25, 0.8), 9.0);
  EXPECT_EQ(ConformalThreshold(scores, 0.25, 0.95), kNone);
  // Wilks: with 95 % confidence the largest of 29 values, but not of 28, exceeds nine tenths of all
  // values. To exceed 95 % of all values, 59 are needed.
  const std::vector<double> many(59, 3.0);
  EXPECT_EQ(ConformalThreshold(std::span(many).first(28), 0.1, 0.95), kNone);
  EXPECT_EQ(ConformalThreshold(std::span(many).first(29), 0.1, 0.95), 3.0);
  EXPECT_EQ(ConformalThreshold(std::span(many).first(58), 0.05, 0.95), kNone);
  EXPECT_EQ(ConformalThreshold(many, 0.05, 0.95), 3.0);
}

TEST(ConformalThresholdTest, ErrorsNameTheReason) {
  const auto message = [](const std::vector<double>& scores, double alpha, double confidence) {
    return dfr::test::MessageOf([&] { (void)ConformalThreshold(scores, alpha, confidence); });
  };
  EXPECT_THAT(message({}, 0.1, 0.5), HasSubstr("no held-out"));
  EXPECT_THAT(message({1.0, std::nan("")}, 0.1, 0.5), HasSubstr("NaN"));
  for (const double alpha : {0.0, 1.0}) {
    EXPECT_THAT(message({1.0}, alpha, 0.5), HasSubstr("alpha must lie"));
  }
  for (const double confidence : {-0.1, 1.0}) {
    EXPECT_THAT(message({1.0}, 0.5, confidence), HasSubstr("confidence"));
  }
}

TEST(ModelSelectionTest, ExcursionScoreIsTheWorstStep) {
  const auto demonstrations = Demonstrations(30, 62);
  const auto support = TimeVaryingSupport::Fit(demonstrations, {.svm = {.nu = 0.1, .gamma = 1.0}});
  core::Matrix states = demonstrations[0];
  double expected = -std::numeric_limits<double>::infinity();
  for (Eigen::Index t = 0; t < states.rows(); ++t) {
    const auto& g = support.at(static_cast<int>(t));
    const double sum = g.Decision(core::Row(states, t)) + g.rho();
    expected = std::max(expected, -std::log(sum / g.rho()));
  }
  EXPECT_NEAR(ExcursionScore(support, states), expected, 1e-12);
  states(4, 0) += 10.0;
  EXPECT_GT(ExcursionScore(support, states), 10.0);
}

TEST(ModelSelectionTest, WiderKernelsAcceptMoreAndTheTightestThatAcceptsEnoughIsChosen) {
  const auto demonstrations = Demonstrations(60, 63);
  SelectionOptions options;
  options.gammas = {0.02, 0.1, 0.5, 5.0, 100.0};
  options.acceptance = 0.85;
  const Selection s = SelectModel(demonstrations, options);
  ASSERT_EQ(s.rows.size(), 5u);
  EXPECT_TRUE(s.accepted);
  EXPECT_GT(s.rows.front().acceptance, s.rows.back().acceptance + 0.2);
  EXPECT_GT(s.rows.front().volume, s.rows.back().volume);
  for (const SelectionRow& r : s.rows) {
    if (r.acceptance >= 0.85) {
      EXPECT_GE(r.volume, s.rows[s.chosen].volume);
    }
  }
  EXPECT_LT(s.rows[s.chosen].gamma, 100.0);
}

TEST(ModelSelectionTest, TheTableDoesNotDependOnTheThreadCount) {
  const std::vector<core::Matrix> demonstrations = Demonstrations(24, 67);
  for (const bool pooled : {false, true}) {
    SelectionOptions options{.gammas = {0.1, 5.0}, .nus = {0.05, 0.3}};
    options.support.pooled = pooled;
    const std::string one = SelectModel(demonstrations, options).Table();
    options.support.threads = 3;
    EXPECT_EQ(SelectModel(demonstrations, options).Table(), one);
  }
}

TEST(ModelSelectionTest, SharedDistancesGiveTheEstimatesOfSeparateFits) {
  const std::vector<core::Matrix> demonstrations = Demonstrations(60, 66);
  const internal::NuGamma grid[] = {{0.05, 0.1}, {0.05, 5.0}, {0.3, 5.0}, {0.3, 40.0}};
  for (const bool pooled : {false, true}) {
    for (const double tolerance : {1e-4, 1e-7}) {  // kernel values in float, and in double
      TimeVaryingSupportOptions options{.svm = {.tolerance = tolerance}, .pooled = pooled};
      options.threads = 2;
      const auto together = internal::FitGrid(internal::Views(demonstrations), options, grid);
      ASSERT_EQ(together.size(), std::size(grid));
      for (std::size_t g = 0; g < std::size(grid); ++g) {
        options.svm.nu = grid[g].nu;
        options.svm.gamma = grid[g].gamma;
        const auto separate = TimeVaryingSupport::Fit(demonstrations, options);
        ASSERT_EQ(together[g].num_steps(), separate.num_steps());
        for (int t = 0; t < separate.num_steps(); ++t) {
          const OneClassSvm& a = together[g].at(t);
          const OneClassSvm& b = separate.at(t);
          EXPECT_EQ(a.gamma(), grid[g].gamma);
          Eigen::VectorXd at_a(60), at_b(60);
          for (Eigen::Index i = 0; i < 60; ++i) {
            const auto x = core::Row(demonstrations[static_cast<std::size_t>(i)], t);
            at_a[i] = a.Decision(x);
            at_b[i] = b.Decision(x);
          }
          // Two solutions differ by about the tolerance divided by nu m. The limit is ten times as
          // large.
          EXPECT_TRUE(dfr::test::AllClose(at_a, at_b, 10.0 * tolerance / b.libsvm_scale()));
        }
      }
    }
  }
}

// 24 demonstrations of 3 equal states, at 0, 1, ... 23. The support of each fold is fitted to 18
// demonstrations.
TEST(ModelSelectionTest, SharesCountStatesDemonstrationsTimeStepsAndDraws) {
  std::vector<core::Matrix> demonstrations;
  demonstrations.reserve(24);
  for (int d = 0; d < 24; ++d) demonstrations.push_back(core::Matrix::Constant(3, 1, d));
  SelectionOptions options{.gammas = {0.005, 50.0}, .nus = {0.5}};
  const Selection s = SelectModel(demonstrations, options);
  ASSERT_EQ(s.rows.size(), 2u);
  for (const SelectionRow& row : s.rows) {
    // A demonstration that stands still has all of its states inside, or none.
    EXPECT_NEAR(row.acceptance, row.inside_throughout, 1e-12);
    EXPECT_NEAR(24.0 * row.inside_throughout, std::round(24.0 * row.inside_throughout), 1e-9);
    EXPECT_GE(row.support_vectors, 0.5 * 18.0);
    EXPECT_LE(row.support_vectors, 18.0);
  }
  // A wide kernel leaves half of the demonstrations, those at the ends, outside.
  EXPECT_NEAR(s.rows[0].acceptance, 0.5, 0.2);
  EXPECT_NEAR(s.rows[0].volume, 0.5, 0.2);
  // Narrow supports contain only their samples: no other demonstration, and little of the space
  // between the samples.
  EXPECT_EQ(s.rows[1].acceptance, 0.0);
  EXPECT_EQ(s.rows[1].support_vectors, 18.0);
  EXPECT_LT(s.rows[1].volume, 0.2);
  EXPECT_GT(s.rows[1].threshold, 40.0);
}

TEST(ModelSelectionTest, TwoDemonstrationsPerFoldAreEnough) {
  EXPECT_EQ(SelectModel(Demonstrations(4, 68), {.gammas = {1.0}, .folds = 2}).rows.size(), 1u);
  EXPECT_EQ(SelectModel(Demonstrations(8, 68), {.gammas = {1.0}, .folds = 4}).rows.size(), 1u);
}

TEST(ModelSelectionTest, WithoutAnAcceptableChoiceTheBestOneIsMarkedAsFailed) {
  SelectionOptions options;
  options.gammas = {50.0, 1000.0};
  options.acceptance = 1.0;
  const Selection s = SelectModel(Demonstrations(20, 64), options);
  EXPECT_FALSE(s.accepted);
  EXPECT_EQ(s.chosen, 0u);
}

TEST(ModelSelectionTest, TheTableHasOneRowPerChoiceAndMarksTheBest) {
  SelectionOptions options;
  options.gammas = {0.1, 1.0};
  options.nus = {0.05, 0.2};
  const Selection s = SelectModel(Demonstrations(16, 65), options);
  ASSERT_EQ(s.rows.size(), 4u);
  EXPECT_EQ(s.rows[2].nu, 0.2);
  EXPECT_THAT(s.Table(), HasSubstr("\n->"));
  const SelectionRow row{.nu = 0.05,
                         .gamma = 0.5,
                         .acceptance = 0.925,
                         .inside_throughout = 0.75,
                         .threshold = 1.5,
                         .support_vectors = 12.0,
                         .volume = 0.25};
  EXPECT_THAT((Selection{.rows = {row}}.Table()),
              HasSubstr("\n->     0.05       0.5   92.5 %       75.0 %         1.5"
                        "             12.0   25.0 %\n"));
}

// Twelve demonstrations near the origin count; twelve far away do not.
TEST(ModelSelectionTest, WeightsFollowTheirDemonstrationsIntoTheFolds) {
  std::vector<core::Matrix> demonstrations;
  std::vector<double> weights;
  for (int d = 0; d < 24; ++d) {
    const bool near = d % 2 == 0;
    demonstrations.push_back(core::Matrix::Constant(3, 1, near ? 0.5 * d : 100.0 + 0.5 * d));
    weights.push_back(near ? 1.0 : 0.0);
  }
  for (const bool pooled : {false, true}) {
    SelectionOptions options{.gammas = {0.05}};
    options.support.pooled = pooled;
    options.support.svm.weights = weights;
    const Selection s = SelectModel(demonstrations, options);
    EXPECT_GT(s.rows[0].acceptance, 0.3);
    EXPECT_LE(s.rows[0].acceptance, 0.5);
    EXPECT_LT(s.rows[0].volume, 0.2);
    options.support.svm.weights = std::span(weights).first(23);
    EXPECT_THAT(dfr::test::MessageOf([&] { (void)SelectModel(demonstrations, options); }),
                HasSubstr("there are 23 weights for 24 demonstrations"));
  }
}

TEST(ModelSelectionTest, ErrorsNameTheDemonstration) {
  const auto with = [](auto&& change) {
    auto demonstrations = Demonstrations(20, 66);
    change(demonstrations[5]);
    return dfr::test::MessageOf([&] { (void)SelectModel(demonstrations, {}); });
  };
  EXPECT_THAT(with([](auto& states) { states.resize(0, 2); }),
              HasSubstr("demonstration 5 has no states"));
  for (const int width : {1, 3}) {
    EXPECT_THAT(with([&](auto& states) { states.setZero(10, width); }),
                HasSubstr("demonstration 5 has states of " + std::to_string(width) +
                          " entries, but demonstration 0 has 2"));
  }
  EXPECT_THAT(with([](auto& states) { states(7, 1) = std::nan(""); }),
              HasSubstr("demonstration 5, state 7 has a non-finite entry"));
}

TEST(ModelSelectionTest, ErrorsNameTheOption) {
  const auto demonstrations = Demonstrations(7, 66);
  const auto with = [&](auto&& change) {
    SelectionOptions options;
    change(options);
    return dfr::test::MessageOf([&] { (void)SelectModel(demonstrations, options); });
  };
  EXPECT_THAT(with([](auto& o) { o.gammas = {}; }), HasSubstr("gammas is empty"));
  EXPECT_THAT(with([](auto& o) { o.nus = {}; }), HasSubstr("nus is empty"));
  EXPECT_THAT(with([](auto& o) { o.folds = 1; }), HasSubstr("folds must be at least 2"));
  EXPECT_THAT(with([](auto& o) { o.acceptance = 0.0; }), HasSubstr("acceptance"));
  EXPECT_THAT(with([](auto& o) { o.false_alarms = 1.0; }), HasSubstr("false_alarms"));
  EXPECT_THAT(with([](auto&) {}), HasSubstr("4 folds need at least 8 demonstrations; there are 7"));
}

}  // namespace
}  // namespace dfr::kernel
