#include "trial_runner.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <string>

#include "dfr/core/random.h"
#include "dfr/experiment/paired_evaluation.h"
#include "dfr/sim/line_tracking/calibration_motion.h"
#include "tests/line_tracking/scene.h"

namespace dfr::apps::line_tracking {
namespace {

using sim::LineTrackingPlant;

// One fit for all tests.
const LineModel& Model() {
  static const LineModel model = [] {
    LineModelOptions options;
    options.hidden = {8};
    options.gammas = {0.1, 0.5};
    return LineModel::Fit(Demonstrate(FromTruth(), Known(FromTruth()), 20, 50, 1), options);
  }();
  return model;
}

// Breaks the camera after a few controls.
class Saboteur final : public control::RolloutObserver {
 public:
  Saboteur(LineTrackingPlant& plant, sim::CameraFault fault) : plant_(plant), fault_(fault) {}
  void OnControl(const control::RolloutEvent& /*event*/) override {
    if (++controls_ == 3) plant_.SetCameraFault(fault_);
  }

 private:
  LineTrackingPlant& plant_;
  sim::CameraFault fault_;
  int controls_ = 0;
};

TEST(LineTrialRunnerTest, CalibrationBringsTheArmBelowAMillimetre) {
  for (const std::uint64_t arm : {1, 2}) {
    sim::LineTrackingOptions options = FromTruth();
    options.arm.seed = arm;
    calibration::CalibrationSummary summary;
    const line_task::LineCalibration found = CalibratePlant(options, 120, 3, &summary);
    ASSERT_TRUE(summary.converged && summary.has_covariance) << summary.message;
    LineTrackingPlant plant(options);
    const auto mean = [&](const line_task::LineCalibration& known) {
      double sum = 0.0;
      for (double error : sim::HeldOutTipErrors(plant, known, 200, 4)) sum += error;
      return sum / 200;
    };
    line_task::LineCalibration uncorrected = Known(options);
    uncorrected.arm = {};
    EXPECT_GT(mean(uncorrected), 3.5);
    EXPECT_LT(mean(found), 1.0);
  }
}

TEST(LineTrialRunnerTest, DemonstrationsAreUndisturbedAndStayAtTheLine) {
  const imitation::DemonstrationSet set = Demonstrate(Disturbed(), Known(Disturbed()), 3, 50, 1);
  ASSERT_EQ(set.trajectories.size(), 3U);
  for (const core::Trajectory& trajectory : set.trajectories) {
    EXPECT_EQ(trajectory.outcome, core::Outcome::kCompleted);
    EXPECT_EQ(trajectory.num_steps(), 50);
    // Beyond where it began, an arm with a good calibration bends off by some tenths of a mm.
    EXPECT_LT((trajectory.states.col(2).array() - trajectory.states(0, 2)).abs().maxCoeff(), 0.7);
    EXPECT_LT((trajectory.controls.rowwise().norm().array() - 0.5).abs().maxCoeff(), 0.01);
  }
}

TEST(LineTrialRunnerTest, SameSeedsGiveTheSameEpisode) {
  const std::vector<std::string> methods = {"baseline", "dfr"};
  LineTrialRunner one(LineModel::Fit(Demonstrate(FromTruth(), Known(FromTruth()), 10, 50, 1),
                                     {.hidden = {4}, .gammas = {0.2}}),
                      methods, FromTruth(), Known(FromTruth()));
  LineTrialRunner other(LineModel::Fit(Demonstrate(FromTruth(), Known(FromTruth()), 10, 50, 1),
                                       {.hidden = {4}, .gammas = {0.2}}),
                        methods, FromTruth(), Known(FromTruth()));
  for (std::uint64_t seed = 0; seed < 5; ++seed) {
    for (int method = 0; method < 2; ++method) {
      experiment::EpisodeResult a = one.Run(method, seed, seed + 100);
      experiment::EpisodeResult b = other.Run(method, seed, seed + 100);
      a.seconds = b.seconds = 0.0;
      EXPECT_EQ(a, b) << "seed " << seed << " method " << method;
    }
  }
}

// Where the platform never stops, a halt is no way out: it carries the line away from the tip.
TEST(LineTrialRunnerTest, InRealTimeAHaltMayCollide) {
  const std::vector<std::string> methods = {"early-stopping", "proportional"};
  std::array<int, 2> collided_after_halt{};
  std::array<int, 2> completed{};
  for (const std::string world : {"frozen", "30ms"}) {
    const bool frozen = world == "frozen";
    LineTrialRunner runner(LineModel::Fit(Demonstrate(FromTruth(), Known(FromTruth()), 10, 50, 1),
                                          {.hidden = {4}, .gammas = {0.2}}),
                           methods, InWorld(FromTruth(), world), Known(FromTruth()));
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
      const experiment::EpisodeResult stopped = runner.Run(0, seed, seed);
      if (stopped.cause.starts_with("after ")) {
        EXPECT_EQ(stopped.outcome, core::Outcome::kCollided);
        ++collided_after_halt[frozen ? 0 : 1];
      }
      completed[frozen ? 0 : 1] +=
          runner.Run(1, seed, seed).outcome == core::Outcome::kCompleted ? 1 : 0;
    }
  }
  EXPECT_EQ(collided_after_halt[0], 0);
  EXPECT_GE(collided_after_halt[1], 8);
  // A controller that sees the line follows it in either world.
  EXPECT_GE(completed[0], 18);
  EXPECT_GE(completed[1], 15);
}

TEST(LineTrialRunnerTest, UnknownWorldsAreNamed) {
  for (const char* world : {"", "fast", "ms", "-1ms", "30", "30msx"}) {
    EXPECT_THROW(static_cast<void>(InWorld(FromTruth(), world)), std::invalid_argument) << world;
  }
}

// From a file the model is the same, bit for bit.
TEST(LineTrialRunnerTest, ModelsSurviveTheirFiles) {
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("trial_runner_test_" + std::to_string(getpid()));
  Model().Save(folder);
  const LineModel loaded = LineModel::Load(folder);
  EXPECT_EQ(loaded.task().lambda(), Model().task().lambda());
  const std::array<double, 4> x = {-20.0, 1.0, 0.2, 0.3};
  EXPECT_EQ(loaded.task().support().Decision(4, x), Model().task().support().Decision(4, x));
  std::filesystem::remove(folder / "support.dfr");
  EXPECT_THROW(static_cast<void>(LineModel::Load(folder)), std::runtime_error);
  std::filesystem::remove_all(folder);
}

TEST(LineTrialRunnerTest, ABlindCameraHaltsTheEpisode) {
  const sim::LineTrackingOptions options;
  const line_task::LineCalibration known = Known(options);
  for (const sim::CameraFault fault :
       {sim::CameraFault::kFrozen, sim::CameraFault::kBlack, sim::CameraFault::kOverexposed,
        sim::CameraFault::kNoLine, sim::CameraFault::kNoTip}) {
    LineTrackingPlant plant(options, &known);
    const auto controller = Model().MakeController("baseline");
    Saboteur saboteur(plant, fault);
    const control::RolloutResult result =
        control::Rollout(plant, *controller, {.plant_seed = 1}, &saboteur);
    EXPECT_EQ(result.outcome, core::Outcome::kHalted);
    EXPECT_EQ(result.halt_cause, control::HaltCause::kStateInvalid);
    EXPECT_EQ(result.policy_steps, 4);
  }
}

TEST(LineTrialRunnerTest, IntrinsicsOfAnotherCameraHaltTheEpisode) {
  const sim::LineTrackingOptions options;
  line_task::LineCalibration foreign = Known(options);
  foreign.camera.fx *= 1.5;
  foreign.camera.fy *= 1.5;
  LineTrackingPlant plant(options, &foreign);
  for (const char* method : {"baseline", "dfr", "guided"}) {
    const auto controller = Model().MakeController(method);
    const control::RolloutResult result = control::Rollout(plant, *controller, {.plant_seed = 1});
    EXPECT_EQ(result.outcome, core::Outcome::kHalted) << method;
    EXPECT_EQ(result.halt_cause, control::HaltCause::kStateInvalid) << method;
    EXPECT_EQ(result.controls(), 0) << method;
  }
}

// Results say what the picture did not show.
TEST(LineTrialRunnerTest, HaltsNameWhatWasNotSeen) {
  const sim::LineTrackingOptions options;
  line_task::LineCalibration foreign = Known(options);
  foreign.camera.fx *= 1.5;
  foreign.camera.fy *= 1.5;
  LineTrialRunner runner(LineModel::Fit(Demonstrate(FromTruth(), Known(FromTruth()), 10, 50, 1),
                                        {.hidden = {4}, .gammas = {0.2}}),
                         {"baseline"}, options, foreign);
  const experiment::EpisodeResult result = runner.Run(0, 1, 1);
  EXPECT_EQ(result.outcome, core::Outcome::kHalted);
  EXPECT_EQ(result.cause,
            std::string("not-seen-") + vision::Name(runner.plant().last_observation().missing));
  EXPECT_NE(runner.plant().last_observation().missing, vision::NotSeen::kNothing);
}

// From images, each thread with its own OpenGL context.
TEST(LineTrialRunnerTest, TheNumberOfThreadsDoesNotMatter) {
  const sim::LineTrackingOptions options = Disturbed();
  const experiment::EvaluationPlan plan{.methods = {"baseline", "guided"},
                                        .learners = {"8"},
                                        .demonstrations = {20},
                                        .trials = 2,
                                        .episodes = 1,
                                        .seed = 5};
  const auto make = [&](const experiment::EvaluationUnit& unit) {
    const auto seed = static_cast<std::uint64_t>(unit.trial);
    return std::make_unique<LineTrialRunner>(
        LineModel::Fit(Demonstrate(FromTruth(), Known(options), unit.demonstrations, 50, seed),
                       {.hidden = {8}, .gammas = {0.05}}),
        plan.methods, options, Known(options));
  };
  const auto run = [&](int threads) {
    auto results = experiment::Evaluate(plan, make, {.threads = threads});
    for (auto& unit : results) {
      for (auto& method : unit.episodes) {
        for (auto& episode : method) episode.seconds = 0.0;
      }
    }
    return results;
  };
  const auto one = run(1);
  ASSERT_EQ(one.size(), 2U);
  EXPECT_EQ(one, run(2));
}

// The goal of guided recovery, also when the platform goes on moving after every control: 95 %
// completed, 2 % collided. Of 100 episodes a method that completes 98 % fails this 5 % of the time;
// the seeds are fixed.
TEST(LineTrialRunnerTest, GuidedRecoveryCompletesOnAMovingPlatform) {
  for (const bool between : {false, true}) {
    SCOPED_TRACE(between);
    sim::LineTrackingOptions options = FromTruth();
    options.disturbance.between = between;
    LineModelOptions model;
    model.hidden = {16};
    model.gammas = {0.1};
    LineTrialRunner runner(LineModel::Fit(Demonstrate(options, Known(options), 50, 50, 1), model),
                           {"baseline", "guided"}, options, Known(options));
    std::array<std::array<int, 3>, 2> counts{};
    for (std::uint64_t seed = 0; seed < 100; ++seed) {
      for (int method = 0; method < 2; ++method) {
        const auto outcome = runner.Run(method, core::DeriveSeed(2, {seed}), seed).outcome;
        ++counts[static_cast<std::size_t>(method)][static_cast<std::size_t>(outcome)];
      }
    }
    EXPECT_GE(counts[1][static_cast<std::size_t>(core::Outcome::kCompleted)], 95);
    EXPECT_LE(counts[1][static_cast<std::size_t>(core::Outcome::kCollided)], 2);
    // Without recovery most collide: the platform does disturb.
    EXPECT_GE(counts[0][static_cast<std::size_t>(core::Outcome::kCollided)], 50);
  }
}

TEST(LineTrialRunnerTest, UnknownMethodsAreNamed) {
  try {
    static_cast<void>(safety::ParseMethod("magic"));
    FAIL();
  } catch (const std::invalid_argument& error) {
    EXPECT_NE(std::string(error.what()).find("magic"), std::string::npos);
    EXPECT_NE(std::string(error.what()).find("early-stopping"), std::string::npos);
  }
}

TEST(LineTrialRunnerTest, TooFewDemonstrationsThrow) {
  const imitation::DemonstrationSet set = Demonstrate(FromTruth(), Known(FromTruth()), 4, 45, 1);
  EXPECT_THROW(static_cast<void>(LineModel::Fit(set, {})), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::apps::line_tracking
