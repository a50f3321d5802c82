#include "dfr/study/placebo.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "apps/study/imitator.h"
#include "apps/study/study.h"
#include "apps/study/tables.h"
#include "apps/study/totals.h"
#include "dfr/study/placebo_runner.h"
#include "dfr/study/policies.h"
#include "tests/support/message_of.h"

namespace dfr::study {
namespace {

// Returns the control .25 in every state.
class Alone final : public control::Controller {
 public:
  [[nodiscard]] int state_dim() const noexcept override { return 1; }
  [[nodiscard]] int control_dim() const noexcept override { return 1; }

 private:
  void DoReset(std::uint64_t /*seed*/) noexcept override {}
  control::Step DoNext(std::span<const double> /*x*/, std::span<double> u) noexcept override {
    u[0] = 0.25;
    return {.mode = control::Mode::kPolicy};
  }
};

class Nominal final : public core::Policy {
 public:
  [[nodiscard]] int state_dim() const noexcept override { return 1; }
  [[nodiscard]] int control_dim() const noexcept override { return 1; }
  void Control(int, std::span<const double>, std::span<double> u) const noexcept override {
    u[0] = -0.5;
  }
};

double Twice(std::span<const double> a, std::span<const double> b) {
  return 2.0 * std::abs(a[0] - b[0]);
}

TEST(PlaceboTest, CorrectsAtItsRate) {
  Placebo placebo(std::make_unique<Alone>(), std::make_shared<Nominal>(), Twice);
  placebo.SetRate(0.2);
  placebo.Reset(7);
  const std::vector<double> x = {0.0};
  std::vector<double> u = {0.0};
  constexpr int kControls = 10'000;
  int corrected = 0;
  for (int i = 0; i < kControls; ++i) {
    const control::Step step = placebo.Next(x, u);
    ASSERT_EQ(u[0], step.filtered ? -0.5 : 0.25);
    if (!step.filtered) continue;
    ASSERT_EQ(step.change, 1.5);
    ++corrected;
  }
  // The tolerance is four standard errors.
  EXPECT_NEAR(corrected, 0.2 * kControls, 4.0 * std::sqrt(0.16 * kControls));
}

TEST(PlaceboTest, HaltsAtItsRateAndOtherwisePasses) {
  Placebo placebo(std::make_unique<Alone>(), nullptr, Twice);
  const std::vector<double> x = {0.0};
  std::vector<double> u = {0.0};
  placebo.Reset(1);
  for (int i = 0; i < 1000; ++i) {
    ASSERT_EQ(placebo.Next(x, u).mode, control::Mode::kPolicy) << "there is no rate yet";
  }
  placebo.SetRate(0.25);
  constexpr int kEpisodes = 2000;
  int controls = 0;
  for (int i = 0; i < kEpisodes; ++i) {
    placebo.Reset(static_cast<std::uint64_t>(i));
    while (placebo.Next(x, u).mode != control::Mode::kHalt) {
      ASSERT_EQ(u[0], 0.25);
      ++controls;
    }
  }
  // The number of controls before the halt is geometric, with mean 3 and variance 12.
  EXPECT_NEAR(controls, 3.0 * kEpisodes, 4.0 * std::sqrt(12.0 * kEpisodes));
}

Study PlaceboStudy() {
  Study study = Study::OfGuards();
  study.tasks = {"reach"};
  study.policies = {"biased", "none"};
  study.controllers = {"guard", "placebo-corrections", "placebo-halts"};
  study.demonstrations = 12;
  study.episodes = 12;
  study.trials = 2;
  study.seed = 3;
  return study;
}

const Row& RowIn(const std::vector<Row>& rows, const std::string& policy,
                 const std::string& method) {
  for (const Row& row : rows) {
    if (row.policy == policy && row.controller == method) return row;
  }
  throw std::logic_error("no such row");
}

// The rate is the guard's rate over all episodes, for any order of methods and number of threads.
TEST(PlaceboTest, HasTheRateOfTheGuardInTheSameRun) {
  Study study = PlaceboStudy();
  study.threads = 1;
  const std::vector<Row> rows = RunStudy(study);
  const Row& guard = RowIn(rows, "biased", "guard");
  const Row& placebo = RowIn(rows, "biased", "placebo-corrections");
  ASSERT_GT(guard.changed, 0.0);
  EXPECT_GT(guard.sized_changes, 0);
  const double rate = guard.changed / guard.controls;
  const double error = std::sqrt(rate * (1.0 - rate) / placebo.controls);
  EXPECT_NEAR(placebo.changed / placebo.controls, rate, 4.0 * error);
  // A halt is not a control. No control is changed.
  EXPECT_EQ(RowIn(rows, "biased", "placebo-halts").changed, 0.0);

  study.threads = 2;
  study.controllers = {"placebo-halts", "placebo-corrections", "guard"};
  const std::vector<Row> reversed = RunStudy(study);
  for (const Row& row : rows) {
    EXPECT_TRUE(RowIn(reversed, row.policy, row.controller) == row) << row.controller;
  }
}

// Counts its episodes, and halts at once.
class Counted final : public control::Controller {
 public:
  explicit Counted(const core::Plant& plant, int& episodes)
      : plant_(&plant), episodes_(&episodes) {}
  [[nodiscard]] int state_dim() const noexcept override { return plant_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return plant_->control_dim(); }

 private:
  void DoReset(std::uint64_t /*seed*/) noexcept override { ++*episodes_; }
  control::Step DoNext(std::span<const double> /*x*/, std::span<double> /*u*/) noexcept override {
    return {.cause = control::HaltCause::kTimeUp};
  }

  const core::Plant* plant_;
  int* episodes_;
};

class CountingRunner final : public PlaceboRunner {
 public:
  CountingRunner(const sim::GalleryTask& task, const FittedTask& fit,
                 const std::vector<std::string>& methods, std::map<std::string, int>& episodes)
      : PlaceboRunner(task.plant->Clone(), {}) {
    AddAll(methods,
           [&](const std::string& method) {
             return std::make_unique<Counted>(*task.plant, episodes[method]);
           },
           fit, {});
  }

 private:
  [[nodiscard]] bool Inside(std::span<const double> /*x*/) const override { return true; }
};

// The measures of a method, such as its recoveries, do not depend on placebos.
TEST(PlaceboTest, EachEpisodeOfTheGuardRunsOnce) {
  const sim::GalleryTask& task = sim::FindGalleryTask("reach");
  const auto demonstrations = sim::Demonstrate(task, 10, 1);
  const FittedTask fit = FittedTask::Fit(task.plant->layout(), demonstrations, task.features);
  experiment::EvaluationPlan plan;
  plan.methods = {"baseline", "guard", "placebo-halts"};
  plan.demonstrations = {10};
  plan.learners = {"lwr"};
  plan.trials = 1;
  plan.episodes = 3;
  std::map<std::string, int> episodes;
  static_cast<void>(experiment::Evaluate(plan,
                                         [&](const experiment::EvaluationUnit& unit) {
                                           auto runner = std::make_unique<CountingRunner>(
                                               task, fit, plan.methods, episodes);
                                           runner->JudgeIn(plan, unit);
                                           return runner;
                                         },
                                         {.threads = 1}));
  EXPECT_EQ(episodes["guard"], plan.episodes);
}

TEST(PlaceboTest, AlsoRunsInAStudyOfControllers) {
  Study study;
  study.out.clear();
  study.tasks = {"planar-corridor"};
  study.conditions = {"as demonstrated"};
  study.policies = {"lwr-cv", "learned"};
  study.controllers = {"guard", "placebo-halts"};
  study.demonstrations = 12;
  study.trials = 1;
  study.episodes = 2;
  const std::vector<Row> rows = RunStudy(study);
  ASSERT_EQ(rows.size(), 6u);
  EXPECT_EQ(rows[0].policy, "lwr-cv");
  EXPECT_EQ(rows[5].controller, "placebo-halts");
  EXPECT_EQ(rows[5].changed, 0.0);
}

TEST(PlaceboTest, WithoutTheGuardThereIsNoRate) {
  Study study = PlaceboStudy();
  study.controllers = {"placebo-halts"};
  EXPECT_THAT(
      dfr::test::MessageOf<std::invalid_argument>([&] { static_cast<void>(RunStudy(study)); }),
      testing::HasSubstr("add 'guard' to the methods"));
}

TEST(NoPolicyTest, GivesZero) {
  const sim::GalleryTask& task = sim::FindGalleryTask("reach");
  const std::vector<core::Trajectory> demonstrations = sim::Demonstrate(task, 4, 1);
  const auto features =
      core::FeatureTransform::Identity(core::FeatureSelection::All(task.plant->state_dim()));
  const auto none = MakeUnlearned("none", features, demonstrations);
  std::vector<double> u(static_cast<std::size_t>(none->control_dim()), 1.0);
  none->Control(3, core::Row(demonstrations[0].states, 3), u);
  for (const double entry : u) EXPECT_EQ(entry, 0.0);
  EXPECT_EQ(MakeUnlearned("good", features, demonstrations), nullptr);
}

Row HandRow(const std::string& task, std::vector<TrialCounts> trials) {
  Row row{{}, task, "as demonstrated", "weak", "guard"};
  for (const TrialCounts& trial : trials) row += trial;
  row.trials = std::move(trials);
  return row;
}

TEST(TotalsTest, ClustersAreTrialsOrTasks) {
  const TrialCounts few{.episodes = 20, .completed = 5, .controls = 100.0, .changed = 10.0};
  const TrialCounts many{.episodes = 20, .completed = 15, .controls = 50.0, .changed = 15.0};
  Row row = HandRow("a", {few, many});
  EXPECT_STREQ(Totals(row).clusters(), "episode");
  EXPECT_EQ(Totals(row).IntervalOf(&TrialCounts::completed).low,
            experiment::ProportionInterval(20, 40).low);
  EXPECT_FALSE(Totals(row).PassedInterval());

  row = HandRow("a", {few, many, few});
  row.change = 3.0;
  row.sized_changes = 4;
  const Totals by_trial(row);
  EXPECT_STREQ(by_trial.clusters(), "trial");
  const std::vector<experiment::ClusterCount> trials = {{5, 20}, {15, 20}, {5, 20}};
  EXPECT_EQ(by_trial.IntervalOf(&TrialCounts::completed).high,
            experiment::ClusteredInterval(trials).high);
  EXPECT_NEAR(by_trial.passed().value(), (0.9 + 0.7 + 0.9) / 3.0, 1e-15);
  EXPECT_EQ(by_trial.change().value(), 0.75);

  std::vector<Row> rows;
  for (const char* task : {"a", "b", "c", "d", "e"}) rows.push_back(HandRow(task, {few, many}));
  const Totals by_task(rows);
  EXPECT_STREQ(by_task.clusters(), "task");
  // All tasks are equal.
  EXPECT_EQ(by_task.IntervalOf(&TrialCounts::completed).low,
            experiment::ClopperPearsonInterval(100, 200).low);
  EXPECT_NEAR(by_task.PassedInterval().value().low, 0.8, 1e-12);
}

TEST(FigureTest, HasOnePointPerMethod) {
  const TrialCounts trial{.episodes = 20, .completed = 15, .controls = 50.0, .changed = 10.0};
  const auto figure = MakeFigure({HandRow("a", {trial})});
  ASSERT_EQ(figure.plots.size(), 1u);
  ASSERT_EQ(figure.plots[0].series.size(), 1u);
  const experiment::ReportSeries& series = figure.plots[0].series[0];
  EXPECT_EQ(series.name, "guard");
  EXPECT_NEAR(series.x[0], 20.0, 1e-12);
  EXPECT_EQ(series.y[0], 0.75);
  EXPECT_LT(series.low[0], 0.75);
  EXPECT_GT(series.high[0], 0.75);
}

// A regression changes none of its controls. Its row must not resemble the row of a perfect guard.
TEST(RowTest, APolicyAmongTheMethodsHasNoShareOfPassedControls) {
  TrialCounts counts{.episodes = 10, .completed = 9, .left_alone = 10, .left_alone_completed = 9};
  counts.controls = 100.0;
  std::vector<Row> rows;
  for (const char* controller : {"baseline", "guard", "lwr", "baseline@none", "ensemble"}) {
    rows.push_back({counts, "a", "c", "learned", controller});
  }
  const auto tables = MakeRowTables(rows, false);
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const bool guards = i < 2;
    EXPECT_EQ(tables[0].rows[i][7].starts_with("90"), i == 1) << rows[i].controller;
    EXPECT_EQ(tables[0].rows[i][8].starts_with("100"), guards) << rows[i].controller;
    EXPECT_EQ(tables[1].rows[i][12].starts_with("100"), guards) << rows[i].controller;
  }
  ASSERT_EQ(MakeFigure(rows).plots[0].series.size(), 2u);
  EXPECT_EQ(MakeFigure(rows).plots[0].series[1].name, "guard");
}

}  // namespace
}  // namespace dfr::study
