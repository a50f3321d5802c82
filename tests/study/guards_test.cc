#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "apps/study/imitator.h"
#include "apps/study/pictures/picture.h"
#include "apps/study/study.h"
#include "apps/study/tables.h"
#include "dfr/core/text/format.h"
#include "dfr/experiment/intervals.h"
#include "tests/experiment/fake_trial_runner.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::study {
namespace {

Study SmallGuards() {
  Study study = Study::OfGuards();
  study.tasks = {"reach", "balance"};
  study.policies = {"good", "biased"};
  study.controllers = GuardNames();
  study.demonstrations = 12;
  study.episodes = 4;
  study.trials = 1;
  study.seed = 3;
  return study;
}

const std::vector<Row>& SmallRows() {
  static const std::vector<Row> rows = RunStudy(SmallGuards());
  return rows;
}

const Row& RowOf(const std::string& task, const std::string& policy, const std::string& method) {
  return *std::ranges::find_if(SmallRows(), [&](const Row& row) {
    return row.task == task && row.policy == policy && row.controller == method;
  });
}

TEST(GuardsTest, CountsStayWithinTheirEpisodesAndAMonitorChangesNothing) {
  ASSERT_EQ(SmallRows().size(), 2u * 2u * (GuardNames().size() + 1));
  for (const Row& row : SmallRows()) {
    EXPECT_EQ(row.episodes, SmallGuards().episodes);
    EXPECT_LE(row.completed + row.collided, row.episodes);
    EXPECT_LE(row.saved_completed, row.saved);
    EXPECT_LE(row.alarmed_failures, row.collided);
    EXPECT_LE(row.alarmed_successes, row.completed);
    if (row.controller != "baseline") continue;
    EXPECT_EQ(row.saved, 0);
    EXPECT_EQ(row.harmed, 0);
    const Row& monitored = RowOf(row.task, row.policy, "monitor");
    EXPECT_EQ(row.completed, monitored.completed);
    EXPECT_EQ(row.collided, monitored.collided);
    EXPECT_EQ(row.controls, monitored.controls);
  }
}

// After early stopping the pole falls, whereas the point stays at rest.
TEST(GuardsTest, AHaltIsJudgedByWhatTheWorldDoesNext) {
  EXPECT_EQ(RowOf("reach", "good", "early-stopping").collided, 0);
  const Row& pole = RowOf("balance", "good", "early-stopping");
  EXPECT_EQ(pole.completed + pole.collided, pole.episodes);
}

// The adversary uses the controlled plant. The system tier has policies that learn again.
TEST(GuardsTest, AGuardSavesEveryEpisodeFromAnAdversary) {
  Study study = SmallGuards();
  study.tasks = {"reach"};
  study.policies = {"none", "at-constraints"};
  study.controllers = {"baseline", "guard"};
  const std::vector<Row> rows = RunStudy(study);
  ASSERT_EQ(rows.size(), 4u);
  EXPECT_EQ(rows[0].completed + rows[0].collided, 0);
  EXPECT_EQ(rows[2].collided, rows[2].episodes);
  EXPECT_EQ(rows[3].saved, rows[3].episodes);
}

TEST(SelectTasksTest, AGroupSelectsItsTasks) {
  const auto all = SelectTasks({"gallery"});
  auto both = SelectTasks({"design", "held-out"});
  EXPECT_EQ(both.size(), all.size());
  EXPECT_TRUE(std::ranges::is_permutation(both, all));
  EXPECT_EQ(SelectTasks({"push", "reach"}), (std::vector<std::string>{"push", "reach"}));
  EXPECT_EQ(SelectTasks({"reach", "gallery", "reach"}).size(), all.size());
  EXPECT_THROW((void)SelectTasks({"magic"}), std::invalid_argument);
}

TEST(RowTableTest, SharesAreOfEpisodesAndAlarmsOfOutcomes) {
  Row monitor{{.episodes = 200,
               .completed = 150,
               .collided = 40,
               .halted = 10,
               .intervened = 40,
               .intervened_completed = 10,
               .left_alone = 160,
               .left_alone_completed = 140,
               .controls = 2500.0,
               .changed = 1000.0},
              "reach",
              "as demonstrated",
              "weak",
              "monitor"};
  monitor.alarmed_failures = 30;
  monitor.alarmed_successes = 15;
  monitor.causes = {{"halted: no-progress", 10}};
  monitor.change = 6.0;
  monitor.sized_changes = 8;
  const auto tables = MakeRowTables({monitor}, true);
  ASSERT_EQ(tables.size(), 3u);
  const std::vector<std::string>& row = tables[1].rows.at(0);
  ASSERT_EQ(row.size(), tables[1].header.size());
  EXPECT_THAT(row[4], testing::StartsWith("75.0 ["));
  EXPECT_THAT(row[5], testing::StartsWith("20.0 ["));
  EXPECT_THAT(row[6], testing::StartsWith("5.0 ["));
  // Wilson's intervals of 10 of 40, and of 140 of the other 160.
  EXPECT_EQ(row[10], "25.0 [14.2, 40.2]");
  EXPECT_EQ(row[11], "87.5 [81.5, 91.8]");
  EXPECT_EQ(row[12], "60.0");  // passed
  EXPECT_EQ(row[13], "0.75");  // the size of changes
  EXPECT_EQ(row[14], "12.5");
  EXPECT_THAT(row[15], testing::StartsWith("75.0 ["));
  EXPECT_THAT(row[16], testing::StartsWith("10.0 ["));
  EXPECT_EQ(tables[2].rows.at(0)[4], "10");
  EXPECT_EQ(tables[2].rows.at(0)[5], "halted: no-progress");
}

TEST(RowTableTest, IntervalsOfAlarmsAreClusteredByTrial) {
  const auto trial = [](int alarms) {
    return TrialCounts{.episodes = 20,
                       .completed = 10,
                       .collided = 10,
                       .alarmed_failures = alarms,
                       .alarmed_successes = alarms};
  };
  Row row{{}, "reach", "c", "weak", "monitor"};
  row.trials = {trial(0), trial(5), trial(10)};
  for (const TrialCounts& each : row.trials) row += each;
  const experiment::Interval interval = experiment::ClusteredInterval(
      std::array<experiment::ClusterCount, 3>{{{0, 10}, {5, 10}, {10, 10}}});
  const std::string text =
      core::Format("50.0 [%.1f, %.1f]", 100.0 * interval.low, 100.0 * interval.high);
  const auto tables = MakeRowTables({row}, false);
  EXPECT_EQ(tables[1].rows.at(0)[15], text);
  EXPECT_EQ(tables[1].rows.at(0)[16], text);
}

TEST(RowTableTest, OnlyMonitorsHaveAlarms) {
  for (const char* method : {"monitor", "monitor/pictures", "guard", "guard/pictures"}) {
    Row row;
    row.controller = method;
    row.episodes = 10;
    row.completed = 8;
    row.collided = 2;
    row.alarmed_failures = 1;
    row.alarmed_successes = 4;
    const auto tables = MakeRowTables({row}, true);
    const bool watches = std::string(method).starts_with("monitor");
    EXPECT_EQ(tables[1].rows.at(0)[15].substr(0, 4), watches ? "50.0" : "") << method;
    EXPECT_EQ(tables[1].rows.at(0)[16].substr(0, 4), watches ? "50.0" : "") << method;
  }
}

TEST(InterventionTest, IsAChangedControlOrAHaltByTheMethod) {
  using core::Outcome;
  const auto intervened = [](Outcome outcome, const char* cause, int changed) {
    return Intervened(
        {.outcome = outcome, .cause = cause, .controls = 20, .changed_controls = changed});
  };
  EXPECT_TRUE(intervened(Outcome::kCompleted, "", 1));
  EXPECT_FALSE(intervened(Outcome::kCompleted, "", 0));
  EXPECT_TRUE(intervened(Outcome::kCollided, "demonstrations", 3));
  EXPECT_FALSE(intervened(Outcome::kCollided, "policy", 0));
  EXPECT_TRUE(intervened(Outcome::kHalted, "early-stopping", 0));
  EXPECT_TRUE(intervened(Outcome::kCollided, "after early-stopping", 0));
  EXPECT_TRUE(intervened(Outcome::kHalted, "time-up", 2));
  for (const char* cause : {"time-up", "control-limit", "plant-refused", "plant-fault"}) {
    EXPECT_FALSE(intervened(Outcome::kHalted, cause, 0)) << cause;
    EXPECT_FALSE(intervened(Outcome::kCollided, (std::string("after ") + cause).c_str(), 0));
  }
}

// In three trials of 30 episodes the method intervenes in 10, 0 and 20 and completes 5, 0 and 20 of
// these. It completes 10, 30 and 10 of the other 20, 30 and 10.
TEST(InterventionTest, SuccessIsAShareOfTheEpisodesOfAllTrials) {
  const auto trial = [](int intervened, int completed, int left_alone_completed) {
    return TrialCounts{.episodes = 30,
                       .completed = completed + left_alone_completed,
                       .intervened = intervened,
                       .intervened_completed = completed,
                       .left_alone = 30 - intervened,
                       .left_alone_completed = left_alone_completed};
  };
  Row alone{{}, "reach", "c", "weak", "baseline"};
  alone.episodes = 90;
  alone.completed = 60;
  alone.trials = {trial(0, 0, 20), trial(0, 0, 20), trial(0, 0, 20)};
  Row guard = alone;
  guard.controller = "guard";
  guard.completed = 75;
  guard.trials = {trial(10, 5, 10), trial(0, 0, 30), trial(20, 20, 10)};
  Row monitor = alone;
  monitor.controller = "monitor";
  for (const experiment::ReportTable& table :
       {MakeTables({alone, guard, monitor})[0], MakeRowTables({alone, guard, monitor}, false)[0],
        MakeRowTables({alone, guard, monitor}, false)[1]}) {
    const auto after = std::ranges::find(table.header, "after intervention");
    ASSERT_NE(after, table.header.end());
    const auto column = static_cast<std::size_t>(after - table.header.begin());
    EXPECT_EQ(table.header.at(column + 1), "without intervention");
    EXPECT_EQ(table.rows[0].at(column) + table.rows[0].at(column + 1), "") << "alone";
    // 25 of 30 and 50 of 60. Trials vary, and the intervals are therefore wider than intervals of
    // episodes.
    for (const std::size_t i : {column, column + 1}) {
      EXPECT_THAT(table.rows[1].at(i), testing::StartsWith("83.3 [")) << table.header[i];
    }
    const experiment::Interval interval =
        experiment::ClusteredInterval(std::array<experiment::ClusterCount, 3>{
            {{.successes = 5, .episodes = 10}, {}, {.successes = 20, .episodes = 20}}});
    EXPECT_EQ(table.rows[1].at(column),
              core::Format("83.3 [%.1f, %.1f]", 100.0 * interval.low, 100.0 * interval.high));
    EXPECT_EQ(table.rows[2].at(column), "-") << "the monitor never intervenes";
    EXPECT_THAT(table.rows[2].at(column + 1), testing::StartsWith("66.7 ["));
  }
}

TEST(InterventionTest, EachEpisodeIsEitherIntervenedInOrLeftAlone) {
  for (const Row& row : SmallRows()) {
    for (const TrialCounts& trial : row.trials) {
      EXPECT_EQ(trial.intervened + trial.left_alone, trial.episodes);
      EXPECT_EQ(trial.intervened_completed + trial.left_alone_completed, trial.completed);
      EXPECT_EQ(trial.intervened, row.intervened);  // there is a single trial
      EXPECT_EQ(trial.intervened_completed, row.intervened_completed);
    }
    if (row.controller == "baseline" || row.controller == "monitor") {
      EXPECT_EQ(row.intervened, 0);
    }
    if (row.changed > 0.0) {
      EXPECT_GT(row.intervened, 0);
    }
  }
  // Early stopping changes no control: the intervention is the end of the episode.
  const Row& stopped = RowOf("reach", "biased", "early-stopping");
  EXPECT_EQ(stopped.changed, 0.0);
  EXPECT_GT(stopped.intervened, 0);
  EXPECT_EQ(stopped.intervened_completed, 0);
}

TEST(RecordTest, EpisodesAreThoseOfTheStudy) {
  Study study = SmallGuards();
  study.tasks = {"reach"};
  study.policies = {"biased"};
  study.controllers = {"guard"};
  const auto count = static_cast<std::size_t>(study.episodes);
  const auto recordings = RecordStudy(study, study.episodes);
  ASSERT_EQ(recordings.size(), 3u * count);
  for (const char* method : {"baseline", "guard"}) {
    const Row& row = RowOf("reach", "biased", method);
    int ok = 0, failed = 0;
    double controls = 0.0;
    for (const experiment::FilmedEpisode& recording : recordings) {
      if (recording.method != (std::string(method) == "guard" ? method : "alone")) continue;
      ok += recording.result.outcome == core::Outcome::kCompleted ? 1 : 0;
      failed += recording.result.outcome == core::Outcome::kCollided ? 1 : 0;
      controls += static_cast<double>(recording.states.rows() - 1);
    }
    EXPECT_EQ(ok, row.completed);
    EXPECT_EQ(failed, row.collided);
    EXPECT_EQ(controls, row.controls);
  }
}

TEST(RerunTest, AFilmOfATaskWithoutPicturesIsRefusedBeforeAnEpisodeRuns) {
  Study study = SmallGuards();
  study.tasks = {"reach"};
  study.policies = {"good"};
  study.controllers = {"monitor"};
  study.out = test::EmptyFolder("rerun_film");
  static_cast<void>(RunStudy(study));
  study.rerun = {.episode = "0/12/reach: as demonstrated/monitor@good/0",
                 .methods = {},
                 .film = study.out / "film.mp4"};
  testing::internal::CaptureStdout();
  EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { static_cast<void>(RunStudy(study)); }),
              testing::HasSubstr("film.mp4: without pictures a film is a page"));
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
}

TEST(SavePictureTest, HasAPlotForTheDemonstrationsAndEachMethod) {
  const sim::GalleryTask& task = sim::FindGalleryTask("push");
  const auto path = dfr::test::ProcessFolder() / "guards_test.html";
  const std::vector<experiment::FilmedEpisode> recordings = {
      {.method = "demonstrations",
       .result = {.outcome = core::Outcome::kCompleted, .cause = {}},
       .states = core::Matrix::Random(5, 5),
       .recovery = {}},
      {.method = "alone",
       .result = {.outcome = core::Outcome::kCollided, .cause = {}},
       .states = core::Matrix::Random(4, 5),
       .recovery = {}}};
  SavePicture(recordings, task, "box[0:2]", path);
  std::ifstream file(path);
  const std::string page((std::istreambuf_iterator<char>(file)), {});
  std::filesystem::remove(path);
  EXPECT_THAT(page, testing::HasSubstr(">demonstrations<"));
  EXPECT_THAT(page, testing::HasSubstr(">collided<"));
  EXPECT_THROW(SavePicture(recordings, task, "box", path), std::invalid_argument);
}

class Constant final : public core::Policy {
 public:
  [[nodiscard]] int state_dim() const noexcept override { return 1; }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  void Control(int t, std::span<const double>, std::span<double> u) const noexcept override {
    u[0] = 0.01 * (t + 1);
    u[1] = 0.5;
  }
};

// The bias varies over episodes from zero to the task's value, and is constant within an episode.
TEST(ImitatorTest, ABiasDiffersBetweenEpisodes) {
  Imitator imitator(std::make_shared<Constant>(), {.bias = {0.0, -0.4}});
  std::vector<double> seen;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    imitator.Reset(seed);
    std::array<double, 2> u{}, v{};
    imitator.Control(0, std::array{0.0}, u);
    imitator.Control(0, std::array{0.0}, v);
    EXPECT_EQ(u, v);
    EXPECT_EQ(u[0], 0.01);
    seen.push_back(u[1]);
  }
  const auto [low, high] = std::ranges::minmax(seen);
  EXPECT_GE(low, 0.1);
  EXPECT_LT(low, 0.12);
  EXPECT_LE(high, 0.5);
  EXPECT_GT(high, 0.48);
}

TEST(ImitatorTest, ALatePolicyReturnsItsEarlierControls) {
  Imitator imitator(std::make_shared<Constant>(), {.late = 3});
  std::array<int, 4> episodes{};
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    imitator.Reset(seed);
    std::vector<double> first;
    for (int t = 0; t < 6; ++t) {
      std::array<double, 2> u{};
      imitator.Control(t, std::array{0.0}, u);
      first.push_back(u[0]);
    }
    const auto late = static_cast<int>(std::ranges::count(first, 0.0));
    ASSERT_LE(late, 3);
    ++episodes[static_cast<std::size_t>(late)];
    for (int t = 0; t < 6; ++t) {
      EXPECT_EQ(first[static_cast<std::size_t>(t)], t < late ? 0.0 : 0.01 * (t - late + 1));
    }
  }
  for (const int n : episodes) EXPECT_GT(n, 10);
}

// The displacements of "pick" are centimetres and its gripper command is +-1: without units, a
// network learns the gripper command alone.
TEST(ImitatorTest, PoliciesThatLearnAgainLearnInTheUnitsOfTheTask) {
  const sim::GalleryTask& task = sim::FindGalleryTask("pick");
  const std::vector<core::Trajectory> demonstrations = sim::Demonstrate(task, 12, 1);
  const FittedTask fit = FittedTask::Fit(task.plant->layout(), demonstrations, task.features);
  const auto error_of = [&](const char* name) {
    Imitator imitator = Imitate(task, demonstrations, fit, *task.plant, name, 1);
    double error = 0.0, square = 0.0;
    std::vector<double> u(static_cast<std::size_t>(task.plant->control_dim()));
    for (const core::Trajectory& d : demonstrations) {
      for (int t = 0; t < d.num_steps(); ++t) {
        imitator.Control(t, core::Row(d.states, t), u);
        error += (core::AsVector(std::span<const double>(u)).head(3) -
                  d.controls.row(t).head(3).transpose())
                     .squaredNorm();
        square += d.controls.row(t).head(3).squaredNorm();
      }
    }
    return error / square;
  };
  const double good = error_of("good");
  EXPECT_LT(good, 0.3);
  for (const char* name : {"ensemble", "dart"}) {
    EXPECT_LT(error_of(name), 2.0 * good) << name;
  }
}

}  // namespace
}  // namespace dfr::study
