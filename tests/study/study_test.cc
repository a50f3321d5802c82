#include "apps/study/study.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "apps/study/planar/methods.h"
#include "apps/study/tables.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/files/atomic_file.h"
#include "dfr/core/random.h"
#include "dfr/core/trajectory.h"
#include "dfr/study/baselines.h"
#include "dfr/study/controller_factory.h"
#include "dfr/study/policies.h"
#include "tests/control/analytic.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::study {
namespace {

using testing::HasSubstr;

std::filesystem::path Folder() {
  return std::filesystem::temp_directory_path() / ("study_test_" + std::to_string(getpid()));
}

Study Small() {
  Study study;
  study.out = Folder();
  study.restart = true;
  study.tasks = {"planar-corridor"};
  study.conditions = {"as demonstrated", "turned 40 deg", "wider starts"};
  study.demonstrations = 30;
  study.trials = 2;
  study.episodes = 10;
  return study;
}

std::vector<Row> Rows(const Study& study) {
  std::vector<Row> rows = RunStudy(study);
  std::filesystem::remove_all(Folder());
  return rows;
}

const Row& Find(const std::vector<Row>& rows, const std::string& condition,
                const std::string& policy, const std::string& controller) {
  for (const Row& row : rows) {
    if (row.condition == condition && row.policy == policy && row.controller == controller) {
      return row;
    }
  }
  throw std::logic_error("no such row");
}

TEST(StressTest, CountsWhatAControllerSavesAndHarms) {
  Study study = Small();
  study.policies = {"lwr", "learned"};
  study.trials = 1;
  study.episodes = 20;
  const std::vector<Row> rows = Rows(study);
  // The corridor lacks the condition of wider starts.
  ASSERT_EQ(rows.size(), 2u * 2u * 4u);
  for (const Row& row : rows) {
    EXPECT_EQ(row.episodes, 20);
    if (row.controller == "baseline") {
      EXPECT_EQ(row.saved + row.harmed, 0);
    } else {
      const Row& alone = Find(rows, row.condition, row.policy, "baseline");
      EXPECT_LE(row.saved, alone.collided);
      EXPECT_LE(row.harmed, alone.completed);
      EXPECT_GE(row.completed, alone.completed - row.harmed);
    }
  }
  // The benefit of a controller, and its maximum cost.
  EXPECT_GE(Find(rows, "as demonstrated", "lwr", "baseline").completed, 18);
  EXPECT_LE(Find(rows, "as demonstrated", "lwr", "controller").harmed, 1);
  EXPECT_LE(Find(rows, "turned 40 deg", "lwr", "controller").collided,
            Find(rows, "turned 40 deg", "lwr", "baseline").collided);
  // Early stopping ends some episodes.
  EXPECT_GE(Find(rows, "as demonstrated", "learned", "early-stopping").harmed +
                Find(rows, "as demonstrated", "learned", "early-stopping").saved,
            1);

  const auto tables = MakeTables(rows);
  ASSERT_EQ(tables.size(), 3u);
  EXPECT_EQ(tables[1].rows.size(), 2u);
  for (const auto& table : tables) {
    for (const auto& row : table.rows) EXPECT_EQ(row.size(), table.header.size());
  }
}

TEST(StressTest, TheGridHasOneRowPerSupportAndOneColumnPerController) {
  Study study = Small();
  study.conditions = {"turned 40 deg"};
  study.policies = {"lwr"};
  study.demonstrations = 12;
  study.trials = 1;
  study.episodes = 2;
  study.controllers = {"dfr/raw",           "controller/raw", "dfr/density", "controller/density",
                       "certified/density", "guard/density"};
  const std::vector<Row> rows = Rows(study);
  EXPECT_GT(Find(rows, "turned 40 deg", "lwr", "guard/density").changed, 0.0);
  const auto tables = MakeGrid(rows);
  ASSERT_EQ(tables.size(), 1u);
  EXPECT_EQ(tables[0].header, (std::vector<std::string>{"support", "alone", "dfr", "controller",
                                                        "certified", "guard"}));
  ASSERT_EQ(tables[0].rows.size(), 2u);
  EXPECT_EQ(tables[0].rows[0][0], "raw");
  EXPECT_EQ(tables[0].rows[0][4], "-");
  EXPECT_EQ(tables[0].rows[1][0], "density");
}

// Controls are metres and a gripper command of +-1: a single unit and limit for all entries would
// move the gripper in steps of metres.
TEST(StressTest, ControllersKeepUnitsThatDiffer) {
  Study study = Small();
  study.tasks = {"pick"};
  study.conditions = {"as demonstrated"};
  study.policies = {"lwr"};
  study.controllers = {"controller", "guard", "controller/density"};
  study.demonstrations = 40;
  study.trials = 1;
  const std::vector<Row> rows = Rows(study);
  ASSERT_EQ(rows.size(), 4u);
  for (const Row& row : rows) {
    EXPECT_GE(row.completed, row.controller == "baseline" ? 7 : 9) << row.controller;
  }
}

TEST(StressTest, ListsFailuresAndHarmedEpisodes) {
  const std::vector<Row> rows = {{{100, 90, 5, 5, 0, 0}, "a", "c", "lwr", "baseline"},
                                 {{100, 95, 0, 5, 5, 2}, "a", "c", "lwr", "controller"},
                                 {{100, 90, 5, 5, 0, 0}, "b", "c", "lwr", "baseline"},
                                 {{100, 95, 1, 4, 4, 0}, "b", "c", "lwr", "controller"},
                                 {{100, 90, 5, 5, 0, 0}, "c", "c", "lwr", "baseline"},
                                 {{100, 87, 0, 13, 5, 3}, "c", "c", "lwr", "controller"},
                                 {{100, 40, 50, 10, 0, 0}, "d", "c", "lwr", "baseline"},
                                 {{100, 30, 10, 60, 40, 10}, "d", "c", "lwr", "controller"}};
  const auto table = WhereItFails(rows, "controller");
  ASSERT_EQ(table.rows.size(), 2u);
  EXPECT_TRUE(table.caption.starts_with("2 of 3 rows")) << table.caption;
  EXPECT_EQ(table.rows[0][0], "b");
  EXPECT_EQ(table.rows[1][0], "c");
  EXPECT_EQ(table.rows[1][5], "5.0 / 3.0");
}

TEST(StressTest, JudgesEachMethodByWhatItSavesHarmsAndPasses) {
  // Three trials of 100 episodes. The policy alone completes 201 of all 300.
  const auto row = [](const char* controller, int completed, int saved, int harmed,
                      double changed) {
    Row made{{}, "reach", "c", "weak", controller};
    made.episodes = 300;
    made.completed = completed;
    made.saved = saved;
    made.harmed = harmed;
    const TrialCounts trial{.episodes = 100,
                            .completed = completed / 3,
                            .saved = saved / 3,
                            .harmed = harmed / 3,
                            .controls = 1000.0,
                            .changed = 1000.0 * changed};
    made.trials = {trial, trial, trial};
    return made;
  };
  std::vector<Row> rows = {
      row("baseline", 201, 0, 0, 0.0),        row("guard", 297, 96, 0, 0.1),
      row("controller", 297, 96, 0, 0.6),     row("dfr", 201, 60, 60, 0.1),
      row("dfr-fine", 240, 90, 51, 0.1),      row("early-stopping", 99, 96, 102, 0.0),
      row("certified", 150, 3, 51, 0.0),      row("monitor", 201, 0, 0, 0.0),
      row("placebo-halts", 30, 90, 180, 0.0), row("lwr", 297, 96, 0, 0.0),
      row("true-jacobian", 297, 96, 0, 0.1)};
  const auto expected = std::map<std::string, std::pair<int, std::string>>{
      {"guard", {0, ""}},
      {"controller", {1, "replaces most"}},
      {"dfr", {1, "not shown to save more than it harms"}},
      {"dfr-fine", {1, "less than a tenth"}},
      {"early-stopping", {2, "less than half as often"}},
      {"certified", {2, "harms more than it saves"}}};
  const auto judgements = JudgeMethods(rows);
  ASSERT_EQ(judgements.size(), expected.size());
  for (const auto& judged : judgements) {
    const auto& [grade, why] = expected.at(judged.method);
    EXPECT_EQ(judged.grade, grade) << judged.method << ": " << judged.why;
    EXPECT_THAT(judged.why, testing::HasSubstr(why)) << judged.method;
  }
  EXPECT_EQ(judgements[0].why,
            "passes 90 % of the controls, saves 32.0 % of the episodes and harms 0.0 %");
  rows.push_back(row("guard", 0, 0, 0, 1.0));
  rows.back().policy = "none";
  EXPECT_EQ(JudgeMethods(rows)[0].why, judgements[0].why);
  for (Row& few : rows) few.trials.resize(1);
  EXPECT_THAT(JudgeMethods(rows)[0].why, testing::HasSubstr("too few trials"));
}

// A study of guards and a study of controllers can have the same plan.
TEST(StressTest, AStudyRefusesTheLedgerOfAnotherKind) {
  const test::TempFolder folder;
  Study study = Study::OfGuards();
  study.out = folder.path;
  study.tasks = {"reach"};
  study.policies = {"lwr"};
  study.controllers = {"guard"};
  study.demonstrations = 10;
  study.trials = 1;
  study.episodes = 2;
  static_cast<void>(RunStudy(study));
  study.kind = Kind::kControllers;
  EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { static_cast<void>(RunStudy(study)); }),
              HasSubstr("kind"));
}

TEST(StressTest, ARestartOfAnInvalidStudyDeletesNothing) {
  std::vector<Study> studies = {Study::OfGuards(), Study::OfPlane(), Small(), Small(), Small()};
  studies[0].tasks = studies[1].tasks = {"pusher"};
  studies[2].conditions = {"wider starts"};
  studies[3].controllers = {"guard", "guard"};
  studies[4].policies = {"lwr"};
  studies[4].controllers = {"lwr"};
  for (Study& study : studies) {
    const test::TempFolder folder;
    core::ReplaceFile(folder / "ledger.jsonl", "previous");
    study.out = folder.path;
    study.restart = true;
    EXPECT_THROW(static_cast<void>(RunStudy(study)), std::invalid_argument);
    EXPECT_EQ(test::FileText(folder / "ledger.jsonl"), "previous");
  }
}

TEST(StressTest, UnknownNamesAreReportedWithTheValidOnes) {
  using Names = std::vector<std::string> Study::*;
  struct Unknown {
    Study study;
    Names names;
    const char* name;
    const char* valid;
  };
  for (auto& [study, names, name, valid] : std::vector<Unknown>{
           {Small(), &Study::tasks, "magic", "planar-corridor"},
           {Small(), &Study::conditions, "magic", "turned 40 deg"},
           {Small(), &Study::policies, "magic", "at-constraints"},
           {Small(), &Study::controllers, "controller/magic", "mahalanobis"},
           {Small(), &Study::controllers, "magic", "early-stopping"},
           {Study::OfGuards(), &Study::tasks, "magic", "two-ways"},
           {Study::OfGuards(), &Study::policies, "magic", "biased"},
           {Study::OfGuards(), &Study::controllers, "magic", "guard"},
       }) {
    study.*names = {name};
    EXPECT_THAT(test::MessageOf<std::invalid_argument>([&] { static_cast<void>(RunStudy(study)); }),
                testing::AllOf(HasSubstr("magic'"), HasSubstr(valid)));
  }
}

TEST(CompareTest, StopsOnceAClearDifferenceIsSettled) {
  Comparison comparison;
  comparison.task = "planar-corridor";
  comparison.demonstrations = 20;
  comparison.trials = 2;
  comparison.pairs = 30;
  comparison.first = "lwr";
  comparison.second = "baseline@none";
  const auto plain = Compare(comparison);
  EXPECT_TRUE(plain.settled());
  EXPECT_LT(plain.pairs(), 12);
  EXPECT_GT(plain.mean(), 0.9);  // compares completion with a halt at the start
  comparison.second = "lwr";
  comparison.pairs = 12;  // The first comparison needed fewer.
  const auto same = Compare(comparison);
  EXPECT_FALSE(same.settled());
  EXPECT_EQ(same.pairs(), 12);
  EXPECT_EQ(same.mean(), 0.0);
  // Most of DFR's episodes halt during the task, and all episodes of the second method halt at the
  // start.
  comparison.task = "push";
  comparison.first = "dfr@lwr";
  comparison.second = "baseline@none";
  comparison.pairs = 12;
  comparison.alpha = 1e-9;
  comparison.credit.halted = 1.0;
  const auto partial = Compare(comparison);
  comparison.credit.halted = 0.0;
  const auto whole = Compare(comparison);
  EXPECT_EQ(partial.pairs(), whole.pairs());
  EXPECT_GT(partial.mean(), whole.mean() + 0.02);
  comparison.condition = "gripper: fork";
  EXPECT_THROW(static_cast<void>(Compare(comparison)), std::invalid_argument);
}

TEST(CompareTest, UsesTheDemonstrationsOfTheConditionAndNoPictures) {
  Comparison comparison;
  comparison.task = "planar-corridor";
  comparison.first = "dfr@lwr";
  comparison.second = "lwr";
  comparison.trials = 1;
  comparison.pairs = 8;
  comparison.credit.halted = 1.0;
  comparison.demonstrations = 10;
  const double few = Compare(comparison).mean();
  comparison.demonstrations = 60;
  ASSERT_NE(Compare(comparison).mean(), few);
  comparison.condition = "10 demonstrations";
  EXPECT_EQ(Compare(comparison).mean(), few);
  comparison.condition = "picture noise 3 %";
  EXPECT_THROW(static_cast<void>(Compare(comparison)), std::invalid_argument);
}

// Each policy learns and runs in the cheapest task.
TEST(BaselinesTest, LearnAndRun) {
  Study study = Small();
  study.conditions = {"as demonstrated"};
  study.policies = {"learned", "ensemble", "dart", "dagger"};
  study.controllers = {"ensemble", "true-jacobian"};
  EXPECT_THROW(static_cast<void>(RunStudy(study)), std::invalid_argument);  // ensemble@dart
  study.controllers = {"true-jacobian"};
  const std::vector<Row> rows = Rows(study);
  ASSERT_EQ(rows.size(), 4u * 2u);
  const auto alone = [&](const std::string& policy) {
    return Find(rows, "as demonstrated", policy, "baseline");
  };
  // A policy that is trained in the states that the learner visits fails less often.
  EXPECT_GE(alone("dagger").completed, alone("learned").completed);
  for (const std::string& policy : study.policies) {
    // Only the oracle tries its control on a copy of the plant.
    EXPECT_LE(Find(rows, "as demonstrated", policy, "true-jacobian").collided,
              alone(policy).collided)
        << policy;
  }
}

class Ones final : public core::Policy {
 public:
  [[nodiscard]] int state_dim() const noexcept override { return 1; }
  [[nodiscard]] int control_dim() const noexcept override { return 1; }
  void Control(int, std::span<const double>, std::span<double> u) const noexcept override {
    u[0] = 1.0;
  }
};

// A supervisor draws its variation from stream 1 of the episode.
TEST(BaselinesTest, TheNoiseOfDartIsNotTheSupervisorsVariation) {
  std::vector<double> noise;
  std::vector<double> variation;
  Expert teaching;
  teaching.learn = [](std::span<const core::Trajectory>, std::uint64_t) {
    return std::make_unique<const Ones>();
  };
  teaching.plant = std::make_shared<test::PointPlant>(test::PointPlantOptions{.start = {0.0}});
  teaching.supervise = [&](const core::SimulatedPlant& plant, int t, std::uint64_t episode,
                           std::span<double> u) {
    std::vector<double> x = {0.0};
    plant.Observe(x);
    if (t == 1 && x[0] != 0.0 && std::abs(x[0]) < 1.0) {
      noise.push_back(x[0]);
      variation.push_back(core::Random(core::DeriveSeed(episode, {1})).Normal());
    }
    u[0] = 0.0;
  };
  core::Trajectory demonstration;
  demonstration.states = core::Matrix::Zero(3, 1);
  demonstration.controls = core::Matrix::Zero(2, 1);
  // No episode completes.
  EXPECT_THROW(static_cast<void>(TrainDart(teaching, Ones(), {&demonstration, 1}, 2)),
               std::invalid_argument);
  ASSERT_GT(noise.size(), 50u);
  for (std::size_t i = 0; i < noise.size(); ++i) {
    EXPECT_GT(std::abs(noise[i] - variation[i]), 1e-6);
  }
}

TEST(BaselinesTest, TheOracleReportsTheControlsThatItChanges) {
  const planar::Task task = planar::MakeTask("push-weak");
  const planar::Methods methods(task, planar::Demonstrate(task, 20, 1));
  const auto plant = task.plant->Clone();
  const auto oracle = methods.Make("true-jacobian", *plant);
  const auto learned = methods.Make("baseline", *plant);
  std::vector<double> x(static_cast<std::size_t>(plant->state_dim()));
  std::vector<double> u(static_cast<std::size_t>(plant->control_dim()));
  std::vector<double> v(u.size());
  int filtered = 0;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    plant->Reset(seed);
    oracle->Reset(seed);
    learned->Reset(seed);
    while (!plant->completed() && !plant->collided()) {
      plant->Observe(x);
      const control::Step step = oracle->Next(x, u);
      if (step.mode == control::Mode::kHalt) break;
      static_cast<void>(learned->Next(x, v));
      ASSERT_EQ(step.filtered, u != v);
      filtered += step.filtered ? 1 : 0;
      if (plant->Apply(u) != core::PlantStatus::kOk) break;
    }
  }
  EXPECT_GT(filtered, 0);
}

TEST(MethodNameTest, HasThreeParts) {
  const MethodName whole = Split("controller@lwr/density");
  EXPECT_EQ(whole.controller, "controller");
  EXPECT_EQ(whole.policy, "lwr");
  EXPECT_EQ(whole.support, "density");
  EXPECT_EQ(Split("dfr/raw").support, "raw");
  EXPECT_EQ(Split("dfr/raw").policy, "");
  EXPECT_EQ(Split("knn").controller, "baseline");
  EXPECT_EQ(Split("knn").policy, "knn");
  for (const char* bad : {"controller@", "controller@magic", "controller/", "controller/magic",
                          "certified", "finite-difference/raw", "true-jacobian/raw", "magic@lwr",
                          "ensemble@lwr", "ensemble/raw", "lwr@knn", "dart@none", "lwr@lwr"}) {
    EXPECT_THROW(static_cast<void>(ParseMethod(bad)), std::invalid_argument) << bad;
  }
}

TEST(NearestNeighbourPolicyTest, RefusesTooManyFeatures) {
  constexpr int kMany = NearestNeighbourPolicy::kMostFeatures + 1;
  core::Trajectory demonstration;
  demonstration.states = core::Matrix::Zero(11, kMany);
  demonstration.controls = core::Matrix::Ones(10, 1);
  EXPECT_THROW(
      NearestNeighbourPolicy(core::FeatureTransform::Identity(core::FeatureSelection::All(kMany)),
                             {&demonstration, 1}),
      std::invalid_argument);
}

}  // namespace
}  // namespace dfr::study
