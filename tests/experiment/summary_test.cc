#include "dfr/experiment/summary.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>

#include "dfr/experiment/report.h"
#include "tests/experiment/fake_trial_runner.h"
#include "tests/support/message_of.h"

namespace dfr::experiment {
namespace {

using core::Outcome;
using nlohmann::json;
using testing::HasSubstr;

// One learner, two data points, `trials` of two episodes:
//   baseline  XX at the first, CH at the second;   dfr  HX and CC.
// C: completed, H: halted, X: collided.
struct ByHand {
  EvaluationPlan plan;
  std::vector<UnitResult> results;

  explicit ByHand(int trials) {
    plan.methods = {"baseline", "dfr"};
    plan.learners = {"8"};
    plan.demonstrations = {6, 60};
    plan.trials = trials;
    plan.episodes = 2;
    plan.seed = 17;
    const EpisodeResult collided{Outcome::kCollided, "policy", 5, 0, 0, 0.5};
    const EpisodeResult completed{Outcome::kCompleted, "", 10, 0, 0, 1.0};
    const EpisodeResult out_of_time{Outcome::kHalted, "time-up", 10, 0, 0, 1.0};
    const EpisodeResult halted{Outcome::kHalted, "iteration-limit", 1010, 1000, 1000, 20.0};
    const EpisodeResult probe{Outcome::kCollided, "probe", 15, 11, 11, 4.0, 6.0, 4};
    for (int trial = 0; trial < trials; ++trial) {
      results.push_back({{trial, 6, "8"}, 3, {1, 2}, {{collided, collided}, {halted, probe}}, {}});
      results.push_back(
          {{trial, 60, "8"}, 0, {1, 2}, {{completed, out_of_time}, {completed, completed}}, {}});
      results.back().measures["overlap"] = trial;
    }
  }
};

TEST(SummarizeTest, CountsByHand) {
  ByHand input(3);
  input.results[1].measures["overlap"] = std::numeric_limits<double>::quiet_NaN();
  const Summary summary = Summarize(input.plan, input.results, {});
  ASSERT_EQ(summary.cells.size(), 4u);
  const Cell& dfr = summary.cells[2];
  EXPECT_EQ(dfr.method, "dfr");
  EXPECT_EQ(dfr.demonstrations, 6);
  EXPECT_EQ(dfr.trials, 3);
  EXPECT_EQ(dfr.episodes, 6);
  EXPECT_EQ(dfr.completed.value, 0.0);
  EXPECT_EQ(dfr.halted.value, 0.5);
  EXPECT_EQ(dfr.collided.value, 0.5);
  EXPECT_NEAR(dfr.collided.interval.low, ClopperPearsonInterval(3, 6).low, 1e-12);
  EXPECT_EQ(dfr.seconds_per_trajectory, 12.0);
  EXPECT_EQ(dfr.controls_per_trajectory, (1010 + 15) / 2.0);
  EXPECT_EQ(dfr.recovery_controls, 1011 / 2.0);
  EXPECT_EQ(dfr.passed, 1.0 - 1011.0 / 1025.0);
  EXPECT_EQ(dfr.change.value(), 6.0 / 4.0);
  EXPECT_EQ(summary.cells[0].passed, 1.0);
  EXPECT_FALSE(summary.cells[0].change);
  EXPECT_EQ(dfr.redrawn_starts, 9);
  EXPECT_EQ(dfr.halt_causes.at("iteration-limit"), 3);
  EXPECT_EQ(dfr.collision_causes.at("probe"), 3);

  ASSERT_EQ(summary.averages.size(), 2u);
  EXPECT_EQ(summary.averages[0].episodes, 12);
  EXPECT_EQ(summary.averages[0].collided.value, 0.5);
  EXPECT_EQ(summary.averages[1].completed.value, 0.5);

  ASSERT_EQ(summary.contrasts.size(), 1u);
  const Contrast& contrast = summary.contrasts[0];
  EXPECT_EQ(contrast.against, "baseline");
  EXPECT_EQ(contrast.ratios.collision_reduction.value(), 0.5);
  EXPECT_EQ(contrast.ratios.completion_ratio.value(), 2.0);
  EXPECT_EQ(contrast.seconds_ratio.value(), (24.0 + 2.0) / (1.0 + 2.0));
  EXPECT_EQ(contrast.controls_ratio.value(), (1025.0 + 20.0) / (10.0 + 20.0));
  EXPECT_EQ(contrast.only_method_collided, 0);
  EXPECT_EQ(contrast.only_reference_collided, 3);
  EXPECT_NEAR(contrast.mcnemar_p, 2.0 / 8.0, 1e-15);

  ASSERT_EQ(summary.measures.size(), 1u);
  EXPECT_EQ(summary.measures[0].demonstrations, 60);
  EXPECT_EQ(summary.measures[0].mean, 1.5) << "of the two trials that define it";
}

// A regression changes none of its controls, and guards no policy.
TEST(SummarizeTest, AnotherPolicyHasNoShareOfPassedControls) {
  ByHand input(5);
  input.plan.policies = input.plan.methods;
  const Summary summary = Summarize(input.plan, input.results, {});
  EXPECT_EQ(summary.cells[0].passed, 1.0) << "the reference";
  EXPECT_FALSE(summary.cells[2].passed);
  EXPECT_TRUE(json::parse(ToJson(summary)).at("averages").at(1).at("passed").is_null());
  std::ostringstream table;
  PrintTable(summary, table);
  EXPECT_THAT(table.str(), testing::ContainsRegex("dfr .* - +1.50\n"));
  const std::string page = RenderReport(summary, {});
  EXPECT_THAT(page, HasSubstr("<td class=\"n\">\u2013</td><td class=\"n\">1.50</td>"));
  EXPECT_THAT(page,
              testing::Not(testing::AnyOf(HasSubstr("of the controls)"), HasSubstr("Judged"))));
}

TEST(SummarizeTest, TrialsAreTheClustersFromFiveOn) {
  const ByHand few(4);
  EXPECT_EQ(Summarize(few.plan, few.results, {}).contrasts[0].clusters, "episodes");
  const ByHand enough(5);
  const Contrast contrast = Summarize(enough.plan, enough.results, {}).contrasts[0];
  EXPECT_EQ(contrast.clusters, "trials");
  // All trials are equal. The interval does not follow from their variation.
  EXPECT_LT(contrast.ratios.collision_reduction_interval.value().low, 0.0);
  EXPECT_GT(contrast.ratios.collision_reduction_interval.value().high, 0.5);
}

// Trials t and t + 5 belong to one of five supervisors, with two trials each.
TEST(SummarizeTest, SupervisorsAreTheClustersFromFiveOn) {
  ByHand input(10);
  // In trials of the first supervisor, dfr also collides at the second data point.
  for (UnitResult& result : input.results) {
    if (result.unit.trial % 5 != 0 || result.unit.demonstrations != 60) continue;
    for (EpisodeResult& episode : result.episodes[1]) episode.outcome = Outcome::kCollided;
  }
  const Summary by_trial = Summarize(input.plan, input.results, {});
  EXPECT_EQ(by_trial.contrasts[0].clusters, "trials");
  input.plan.supervisors = 5;
  const Summary by_supervisor = Summarize(input.plan, input.results, {});
  EXPECT_EQ(by_supervisor.contrasts[0].clusters, "supervisors");
  const std::vector<ClusterCount> clusters = {{6, 8}, {2, 8}, {2, 8}, {2, 8}, {2, 8}};
  const Interval expected = ClusteredInterval(clusters);
  const Cell& dfr = by_supervisor.averages[1];
  EXPECT_EQ(dfr.collided.value, 14.0 / 40.0);
  EXPECT_EQ(dfr.collided.interval.low, expected.low);
  EXPECT_EQ(dfr.collided.interval.high, expected.high);
  EXPECT_LT(dfr.collided.interval.low, by_trial.averages[1].collided.interval.low);
  // Four supervisors have two more pairs in which only the reference collides than pairs in which
  // only dfr collides. The first supervisor has two fewer. The sum of differences is 6, and 12 of
  // the 32 combinations of signs give 6 or more in either direction.
  EXPECT_NEAR(by_supervisor.contrasts[0].mcnemar_p, 12.0 / 32.0, 1e-15);
}

TEST(SummarizeTest, RefusesResultsOfAnotherPlan) {
  ByHand input(2);
  input.results.pop_back();
  EXPECT_THROW((void)Summarize(input.plan, input.results, {}), std::invalid_argument);
  input.results.push_back(input.results.front());
  EXPECT_THROW((void)Summarize(input.plan, input.results, {}), std::invalid_argument);
}

TEST(SummaryJsonTest, HasTheDocumentedShape) {
  const auto results = Evaluate(test::FakePlan(), test::MakeFakeTrialRunner);
  const Summary summary = Summarize(test::FakePlan(), results,
                                    {.experiment = "pusher", .preset = "quick", .commit = "abc"});
  const std::filesystem::path path = test::EmptyFolder("summary") / "summary.json";
  SaveSummary(summary, path);
  std::ifstream file(path);
  const json parsed = json::parse(file);
  EXPECT_EQ(parsed.at("experiment"), "pusher");
  EXPECT_EQ(parsed.at("preset"), "quick");
  EXPECT_EQ(parsed.at("commit"), "abc");
  EXPECT_EQ(parsed.at("seed"), 3);
  ASSERT_EQ(parsed.at("cells").size(), 2u * 2u * 2u);
  for (const json& cell : parsed.at("cells")) {
    EXPECT_EQ(cell.at("trials"), 5);
    EXPECT_EQ(cell.at("episodes"), 60);
    for (const char* key :
         {"method", "learner", "demonstrations", "recovery_controls", "passed", "change"}) {
      EXPECT_TRUE(cell.contains(key)) << key;
    }
    EXPECT_GT(cell.at("controls_per_trajectory"), 0.0);
    double sum = 0.0;
    for (const std::string share : {"completed", "halted", "collided"}) {
      const double value = cell.at(share);
      const json& interval = cell.at(share + "_interval");
      ASSERT_EQ(interval.size(), 2u);
      EXPECT_LE(interval[0], value);
      EXPECT_GE(interval[1], value);
      sum += value;
    }
    EXPECT_NEAR(sum, 1.0, 1e-12);
  }
  ASSERT_EQ(parsed.at("contrasts").size(), 2u);
  for (const json& contrast : parsed.at("contrasts")) {
    EXPECT_EQ(contrast.at("method"), "dfr");
    EXPECT_EQ(contrast.at("against"), "baseline");
    EXPECT_TRUE(contrast.at("learner").is_string());
    EXPECT_TRUE(contrast.at("collision_reduction").is_number());
    EXPECT_EQ(contrast.at("interval"), contrast.at("collision_reduction_interval"));
    EXPECT_TRUE(contrast.at("completion_ratio").is_number());
    EXPECT_EQ(contrast.at("completion_ratio_interval").size(), 2u);
  }
}

TEST(SummaryJsonTest, UndefinedFiguresAreNull) {
  ByHand input(1);
  input.plan.demonstrations = {60};
  input.results.erase(input.results.begin());  // leaves a baseline without collisions
  const std::string text = ToJson(Summarize(input.plan, input.results, {}));
  const json parsed = json::parse(text);  // throws on NaN
  EXPECT_TRUE(parsed.at("contrasts")[0].at("collision_reduction").is_null());
  EXPECT_TRUE(parsed.at("contrasts")[0].at("interval").is_null());
  EXPECT_EQ(parsed.at("contrasts")[0].at("completion_ratio"), 2.0);
}

TEST(SummaryJsonTest, AFolderThatDoesNotExistIsNamed) {
  const std::filesystem::path path = test::EmptyFolder("summary_missing") / "no" / "summary.json";
  EXPECT_THAT(dfr::test::MessageOf<std::runtime_error>([&] { SaveSummary({}, path); }),
              HasSubstr(path.string()));
}

TEST(PrintTableTest, ShowsEveryCellAndTheContrast) {
  const ByHand input(5);
  std::ostringstream out;
  PrintTable(Summarize(input.plan, input.results, {}), out);
  EXPECT_THAT(out.str(),
              HasSubstr("learner 8: all data points, 20 episodes per method in 5 trials, %; "
                        "42.9 % of the start states drawn were outside"));
  EXPECT_THAT(out.str(), HasSubstr("dfr        50.0 [ 27.2, 72.8]"));
  // 1011 of 1045 controls differ from the policy's.
  EXPECT_THAT(out.str(), testing::ContainsRegex("dfr +50.0 .* 3.3 +1.50\n"));
  EXPECT_THAT(out.str(), HasSubstr("against baseline: completions 200 % [62, 746], "
                                   "collisions -50 % [-87, 61], time x8.67"));
  EXPECT_THAT(out.str(), HasSubstr("  demos              baseline                   dfr\n"
                                   "      6     0.0 /  0.0 /100.0     0.0 / 50.0 / 50.0\n"
                                   "     60    50.0 / 50.0 /  0.0   100.0 /  0.0 /  0.0\n"));
}

}  // namespace
}  // namespace dfr::experiment
