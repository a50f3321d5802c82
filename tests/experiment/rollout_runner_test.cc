#include "dfr/experiment/rollout_runner.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <csignal>
#include <fstream>
#include <memory>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/experiment/experiment.h"
#include "dfr/experiment/film.h"
#include "dfr/experiment/ledger.h"
#include "tests/control/analytic.h"
#include "tests/experiment/fake_trial_runner.h"
#include "tests/support/message_of.h"

namespace dfr::experiment {
namespace {

using control::Mode;

// Moves right by 0.1 per control: two controls of the policy, three of a recovery, one of the
// policy, one of a recovery. Then halts.
class Script final : public control::Controller {
 public:
  [[nodiscard]] int state_dim() const noexcept override { return 1; }
  [[nodiscard]] int control_dim() const noexcept override { return 1; }

 private:
  void DoReset(std::uint64_t /*seed*/) noexcept override { next_ = 0; }
  control::Step DoNext(std::span<const double> /*x*/, std::span<double> u) noexcept override {
    constexpr Mode kModes[] = {Mode::kPolicy,   Mode::kPolicy, Mode::kProbe,    Mode::kRecovery,
                               Mode::kRecovery, Mode::kPolicy, Mode::kRecovery, Mode::kHalt};
    u[0] = 0.1;
    control::Step step;
    // Every control except the probe has a change.
    if (next_ != 2) step.change = 0.5;
    step.mode = kModes[next_++];
    if (step.mode == Mode::kHalt) step.cause = control::HaltCause::kOutsideSupport;
    return step;
  }
  std::size_t next_ = 0;
};

// Starts at 0. On request, the world continues to move after a halt.
class PointRunner final : public RolloutRunner {
 public:
  PointRunner(double wall, double goal, bool moves_on,
              const experiment::DisturbanceOptions& disturbance = {})
      : RolloutRunner(std::make_unique<test::PointPlant>(
                          test::PointPlantOptions{.start = {0.0}, .wall = wall, .goal = goal}),
                      disturbance),
        moves_on_(moves_on) {
    Add("script", std::make_unique<Script>());
  }

 private:
  [[nodiscard]] bool Inside(std::span<const double> x) const override { return x[0] >= 0.0; }
  [[nodiscard]] bool CollidesAfterHalt() override {
    if (!moves_on_) return false;
    for (int i = 0; i < 20; ++i) {
      EXPECT_EQ(world().Apply(std::vector<double>{0.1}), core::PlantStatus::kOk);
    }
    return world().collided();
  }
  bool moves_on_;
};

constexpr double kNone = 1e9;

TEST(RolloutRunnerTest, CountsTheControlsOfEachRecovery) {
  PointRunner runner(kNone, kNone, false);
  EXPECT_TRUE(runner.Accepts(1));
  const EpisodeResult result = runner.Run(0, 1, 2);
  EXPECT_EQ(result.outcome, core::Outcome::kHalted);
  EXPECT_EQ(result.cause, "outside-support");
  EXPECT_EQ(result.controls, 7);
  EXPECT_EQ(result.recovery_controls, 4);
  // The sizes of changed controls count. The probe has no size.
  EXPECT_EQ(result.changed_controls, 4);
  EXPECT_EQ(result.sized_changes, 3);
  EXPECT_EQ(result.change, 1.5);
  EXPECT_EQ(runner.recovery_lengths()[0], (std::vector<int>{3, 1}));
}

TEST(RolloutRunnerTest, NamesTheModeThatCollided) {
  PointRunner runner(0.45, kNone, false);  // the fifth control reaches the wall
  const EpisodeResult result = runner.Run(0, 1, 2);
  EXPECT_EQ(result.outcome, core::Outcome::kCollided);
  EXPECT_EQ(result.cause, "recovery");
  EXPECT_EQ(runner.recovery_lengths()[0], (std::vector<int>{3}));
  PointRunner there(kNone, 0.15, false);
  EXPECT_EQ(there.Run(0, 1, 2).outcome, core::Outcome::kCompleted);
  EXPECT_EQ(there.Run(0, 1, 2).cause, "");
}

TEST(RolloutRunnerTest, AHaltMayCollideWhereTheWorldMovesOn) {
  for (const bool disturbed : {false, true}) {
    const experiment::DisturbanceOptions disturbance{.control_delay = disturbed ? 1 : 0};
    PointRunner runner(2.0, kNone, true, disturbance);
    const EpisodeResult result = runner.Run(0, 1, 2);
    EXPECT_EQ(result.outcome, core::Outcome::kCollided);
    EXPECT_EQ(result.cause, "after outside-support");
  }
  PointRunner roomy(5.0, kNone, true);
  EXPECT_EQ(roomy.Run(0, 1, 2).outcome, core::Outcome::kHalted);
}

TEST(RolloutRunnerTest, AFilmIsAPageOfTheUndisturbedStates) {
  const std::filesystem::path folder = test::EmptyFolder("film");
  PointRunner runner(kNone, kNone, false, {.observation_noise = 100.0});
  ASSERT_TRUE(runner.Film({0, 0}, 1, 2, folder / "film.html"));
  std::stringstream page;
  page << std::ifstream(folder / "film.html").rdbuf();
  EXPECT_NE(page.str().find("script: halted: outside-support after 7 controls, 4 of them recovery"),
            std::string::npos);
  // A mark's text gives the state after the last control.
  EXPECT_NE(page.str().find("<title>script, controls 7: 0.7000</title>"), std::string::npos);
  const std::string message = test::MessageOf<std::runtime_error>(
      [&] { static_cast<void>(runner.Film({0}, 1, 2, folder / "film.mp4")); });
  EXPECT_NE(message.find("film.mp4: without pictures a film is a page: choose a name"),
            std::string::npos)
      << message;
}

TEST(FilmTest, RoundingAndLargeValuesGetTicks) {
  FilmedEpisode episode{
      .method = "still", .result = {}, .states = core::Matrix(2, 2), .recovery = {}};
  episode.states << 0.3, 5e9, 0.3 + 3e-11, 5e9 + 6.0;
  const std::filesystem::path path = test::EmptyFolder("film_ticks") / "film.html";
  SaveFilm("Still", core::StateLayout{{{"angle", 0, 1}, {"time", 1, 1}}}, {&episode, 1}, path);
  std::stringstream page;
  page << std::ifstream(path).rdbuf();
  for (const char* tick : {">0.4</text>", ">5000000002</text>"}) {
    EXPECT_NE(page.str().find(tick), std::string::npos) << tick;
  }
}

TEST(ExperimentTest, WritesALedgerAndASummaryAndResumes) {
  ExperimentOptions options;
  options.out = test::EmptyFolder("experiment") / "new";
  options.configuration = [] { return "[experiment]\n"; };
  std::optional<OutputFolder> folder(std::in_place, options, test::FakePlan());
  const auto first =
      RunExperiment("fake", test::FakePlan(), test::MakeFakeTrialRunner, {{"gamma", "1"}}, options);
  for (const char* file : {"summary.json", "times.json", "run.toml"}) {
    EXPECT_TRUE(std::filesystem::exists(options.out / file)) << file;
  }
  const auto unused = [](const EvaluationUnit&) -> std::unique_ptr<TrialRunner> {
    throw std::logic_error("all units are in the ledger");
  };
  const auto again = RunExperiment("fake", test::FakePlan(), unused, {{"gamma", "1"}}, options);
  ASSERT_TRUE(first.has_value() && again.has_value());
  EXPECT_EQ(first->units, again->units);
  EXPECT_THROW((void)RunExperiment("fake", test::FakePlan(), unused, {{"gamma", "2"}}, options),
               std::runtime_error);
  options.restart = true;
  EXPECT_THROW(OutputFolder second(options, test::FakePlan()), std::runtime_error)
      << "the folder is locked";
  EXPECT_TRUE(std::filesystem::exists(options.out / "summary.json")) << "and is unchanged";
  folder.reset();
  std::ofstream(options.out / "study.csv") << "old";
  std::ofstream(options.out / "report.html") << "old";
  std::ofstream(options.out / "notes.txt") << "the user's";
  EvaluationPlan twice = test::FakePlan();
  twice.methods.push_back(twice.methods.front());
  EXPECT_THROW(OutputFolder wrong(options, twice), std::invalid_argument);
  EXPECT_TRUE(std::filesystem::exists(options.out / "ledger.jsonl")) << "a mistake deletes nothing";
  folder.emplace(options, test::FakePlan());
  for (const char* file :
       {"ledger.jsonl", "summary.json", "times.json", "study.csv", "report.html"}) {
    EXPECT_FALSE(std::filesystem::exists(options.out / file)) << file;
  }
  EXPECT_TRUE(std::filesystem::exists(options.out / "notes.txt"));
  EXPECT_THROW((void)RunExperiment("fake", test::FakePlan(), unused, {{"gamma", "1"}}, options),
               std::logic_error);
  std::ofstream(options.out / "file") << "not a folder";
  options.out = options.out / "file" / "below";
  EXPECT_THROW(OutputFolder nowhere(options, test::FakePlan()), std::runtime_error);
  options.out.clear();
  options.shard = {1, 2};
  EXPECT_THAT(test::MessageOf([&] { const OutputFolder none(options, test::FakePlan()); }),
              testing::HasSubstr("a shard needs --out"));
}

TEST(ExperimentTest, AFilmThatCannotBeWrittenFailsBeforeItsUnitIsLearned) {
  ExperimentOptions options;
  options.out = test::EmptyFolder("experiment_film");
  const OutputFolder folder(options, test::FakePlan());
  ASSERT_TRUE(RunExperiment("fake", test::FakePlan(), test::MakeFakeTrialRunner, {}, options));
  options.rerun = {.episode = "0/60/8/dfr/3", .methods = {}, .film = options.out / "new/film.mp4"};
  int learned = 0;
  const auto make = [&](const EvaluationUnit& unit) {
    ++learned;
    return test::MakeFakeTrialRunner(unit);
  };
  const auto check = [&](const EvaluationUnit& unit, const std::filesystem::path& film) {
    EXPECT_EQ(unit.demonstrations, 60);
    EXPECT_TRUE(std::filesystem::is_directory(film.parent_path()));
    throw std::runtime_error("no codec");
  };
  EXPECT_EQ(test::MessageOf<std::runtime_error>([&] {
              static_cast<void>(RunExperiment("fake", test::FakePlan(), make, {}, options, check));
            }),
            "no codec");
  EXPECT_EQ(learned, 0);
  options.rerun.film.clear();
  EXPECT_FALSE(RunExperiment("fake", test::FakePlan(), make, {}, options, check));
  EXPECT_EQ(learned, 1);
}

TEST(ExperimentTest, AShardWritesOnlyItsLedger) {
  ExperimentOptions options;
  options.out = test::EmptyFolder("experiment_shard");
  options.shard = {2, 3};
  const OutputFolder folder(options, test::FakePlan());
  EXPECT_FALSE(
      RunExperiment("fake", test::FakePlan(), test::MakeFakeTrialRunner, {}, options).has_value());
  EXPECT_TRUE(std::filesystem::exists(options.out / "ledger.jsonl"));
  EXPECT_FALSE(std::filesystem::exists(options.out / "summary.json"));
}

// After a scheduler's signal, running units finish, and the next run resumes.
TEST(ExperimentTest, AfterASignalNoFurtherUnitBegins) {
  ExperimentOptions options;
  options.out = test::EmptyFolder("experiment_signal");
  options.threads = 1;
  const OutputFolder folder(options, test::FakePlan());
  int made = 0;
  const auto signalled = [&](const EvaluationUnit& unit) {
    if (++made == 4) std::raise(SIGUSR1);
    return test::MakeFakeTrialRunner(unit);
  };
  EXPECT_THROW((void)RunExperiment("fake", test::FakePlan(), signalled, {}, options), Interrupted);
  EXPECT_EQ(made, 4);
  EXPECT_EQ(ReadLedger(options.out / "ledger.jsonl").records.size(), 4u);
  EXPECT_TRUE(RunExperiment("fake", test::FakePlan(), signalled, {}, options).has_value());
  made = 0;
  options.out.clear();
  const std::string message = test::MessageOf<Interrupted>(
      [&] { static_cast<void>(RunExperiment("fake", test::FakePlan(), signalled, {}, options)); });
  EXPECT_TRUE(message.ends_with("units, which are lost; a run with --out keeps finished units"))
      << message;
}

}  // namespace
}  // namespace dfr::experiment
