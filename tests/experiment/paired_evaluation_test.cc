#include "dfr/experiment/paired_evaluation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <map>
#include <set>
#include <stdexcept>
#include <string>

#include "tests/experiment/fake_trial_runner.h"
#include "tests/support/message_of.h"

namespace dfr::experiment {
namespace {

using test::FakePlan;
using test::MakeFakeTrialRunner;
using testing::HasSubstr;

TEST(EvaluateTest, CoversThePlanInItsOrder) {
  const EvaluationPlan plan = FakePlan();
  const auto results = Evaluate(plan, MakeFakeTrialRunner);
  ASSERT_EQ(results.size(), 20u);
  EXPECT_EQ(results[0].unit, (EvaluationUnit{0, 6, "8"}));
  EXPECT_EQ(results[1].unit, (EvaluationUnit{0, 6, "64-64"}));
  EXPECT_EQ(results[2].unit, (EvaluationUnit{0, 60, "8"}));
  EXPECT_EQ(results[4].unit, (EvaluationUnit{1, 6, "8"}));
  for (const UnitResult& result : results) {
    ASSERT_EQ(result.episodes.size(), 2u);
    EXPECT_EQ(result.episodes[0].size(), 12u);
    EXPECT_EQ(result.episodes[1].size(), 12u);
  }
}

TEST(EvaluateTest, AnyNumberOfThreadsGivesTheSameResults) {
  const EvaluationPlan plan = FakePlan();
  const auto one = Evaluate(plan, MakeFakeTrialRunner, {.threads = 1});
  EXPECT_EQ(Evaluate(plan, MakeFakeTrialRunner, {.threads = 2}), one);
  EXPECT_EQ(Evaluate(plan, MakeFakeTrialRunner, {.threads = 7}), one);
}

TEST(EvaluateTest, MethodsAndLearnersShareStartStatesAndControllerSeeds) {
  struct Seen {
    int method;
    std::uint64_t start, controller;
  };
  struct Runner final : TrialRunner {
    explicit Runner(std::vector<Seen>* record) : seen(record) {}
    bool Accepts(std::uint64_t) override { return true; }
    EpisodeResult Run(int method, std::uint64_t start, std::uint64_t controller) override {
      seen->push_back({method, start, controller});
      return {};
    }
    std::vector<Seen>* seen;
  };
  std::map<std::string, std::vector<Seen>> seen;  // by learner
  EvaluationPlan plan = FakePlan();
  plan.trials = 2;
  plan.demonstrations = {6};
  const auto make = [&](const EvaluationUnit& unit) {
    return std::make_unique<Runner>(&seen[unit.learner]);
  };
  (void)Evaluate(plan, make, {.threads = 1});
  const auto& weak = seen.at("8");
  const auto& strong = seen.at("64-64");
  ASSERT_EQ(weak.size(), 48u);
  std::set<std::uint64_t> starts, controllers;
  for (std::size_t i = 0; i < weak.size(); ++i) {
    EXPECT_EQ(weak[i].start, strong[i].start);
    EXPECT_EQ(weak[i].controller, strong[i].controller);
    EXPECT_EQ(weak[i].method, static_cast<int>(i % 2));
    EXPECT_EQ(weak[i].start, weak[i / 2 * 2].start);
    EXPECT_EQ(weak[i].controller, weak[i / 2 * 2].controller);
    starts.insert(weak[i].start);
    controllers.insert(weak[i].controller);
  }
  EXPECT_EQ(starts.size(), 24u) << "12 episodes in each of 2 trials, all different";
  EXPECT_EQ(controllers.size(), 24u);
}

TEST(EvaluateTest, RefusedStartStatesAreRedrawnAndCounted) {
  // Accepts every third start state, and records all of them.
  struct Runner final : TrialRunner {
    bool Accepts(std::uint64_t seed) override {
      asked.push_back(seed);
      return asked.size() % 3 == 0;
    }
    EpisodeResult Run(int, std::uint64_t start, std::uint64_t) override {
      EXPECT_EQ(start, asked.back());
      return {};
    }
    std::vector<std::uint64_t> asked;
  };
  EvaluationPlan plan = FakePlan();
  plan.trials = 1;
  plan.demonstrations = {6};
  plan.learners = {"8"};
  const auto make = [](const EvaluationUnit&) { return std::make_unique<Runner>(); };
  const auto results = Evaluate(plan, make);
  EXPECT_EQ(results[0].redrawn, 2 * 12);
  plan.max_redraws = 2;
  EXPECT_THAT(test::MessageOf([&] { (void)Evaluate(plan, make); }),
              HasSubstr("none of 2 drawn start states is inside the support (trial 0, 6 "
                        "demonstrations, 8)"));
}

TEST(EvaluateTest, ARunnerThatThrowsEndsTheRun) {
  for (const int threads : {1, 2}) {
    std::atomic<int> made{0};
    const auto make = [&](const EvaluationUnit& unit) {
      if (++made == 3) throw std::runtime_error("no such policy");
      return MakeFakeTrialRunner(unit);
    };
    EXPECT_THAT(test::MessageOf([&] { (void)Evaluate(FakePlan(), make, {.threads = threads}); }),
                HasSubstr("no such policy"));
    if (threads == 1) {
      EXPECT_EQ(made, 3);
    }
  }
}

TEST(EvaluateTest, RefusesPlansThatCannotBeRun) {
  const auto message = [](const std::function<void(EvaluationPlan&)>& change) {
    EvaluationPlan plan = FakePlan();
    change(plan);
    return test::MessageOf([&] { (void)Evaluate(plan, MakeFakeTrialRunner); });
  };
  EXPECT_THAT(message([](auto& plan) { plan.methods.clear(); }), HasSubstr("at least one method"));
  EXPECT_THAT(message([](auto& plan) {
                plan.methods = {"b", "a", "a"};
              }),
              HasSubstr("method 'a' is named twice"));
  EXPECT_THAT(message([](auto& plan) { plan.learners.clear(); }),
              HasSubstr("at least one learner"));
  EXPECT_THAT(message([](auto& plan) { plan.demonstrations = {6, 3}; }), HasSubstr("ascending"));
  EXPECT_THAT(message([](auto& plan) { plan.demonstrations = {0, 3}; }), HasSubstr("not 0"));
  EXPECT_THAT(message([](auto& plan) { plan.trials = 0; }), HasSubstr("trials"));
  EXPECT_THAT(message([](auto& plan) { plan.episodes = 0; }), HasSubstr("episodes"));
}

TEST(EvaluateTest, ShardsAreWrittenAsFractions) {
  EXPECT_THROW((void)Evaluate(FakePlan(), MakeFakeTrialRunner, {.shard = {3, 2}}),
               std::invalid_argument);
  EXPECT_EQ(ParseShard("2/7"), (Shard{2, 7}));
  for (const char* wrong : {"", "2", "2/", "/7", "0/7", "8/7", "2/7x", "-1/7", " 2/7", "2/-7"}) {
    EXPECT_THROW((void)ParseShard(wrong), std::invalid_argument) << wrong;
  }
}

}  // namespace
}  // namespace dfr::experiment
