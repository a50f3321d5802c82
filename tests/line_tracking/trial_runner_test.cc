#include "trial_runner.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <string>

#include "dfr/experiment/paired_evaluation.h"
#include "dfr/sim/line_tracking/calibration_motion.h"
#include "probe_study.h"
#include "tests/line_tracking/demonstrations.h"
#include "tests/support/temp_folder.h"

namespace dfr::apps::line_tracking {
namespace {

using sim::LineTrackingPlant;

TEST(LineTrialRunnerTest, CalibrationBringsTheArmBelowAMillimetre) {
  const sim::LineTrackingOptions options = FromTruth();
  calibration::CalibrationSummary summary;
  const line_task::LineCalibration found = CalibratePlant(options, 30, 3, &summary);
  ASSERT_TRUE(summary.converged && summary.has_covariance) << summary.message;
  LineTrackingPlant plant(options);
  const auto mean = [&](const line_task::LineCalibration& known) {
    double sum = 0.0;
    for (double error : sim::HeldOutTipErrors(plant, known, 50, 4)) sum += error;
    return sum / 50;
  };
  line_task::LineCalibration uncorrected = test::PerfectCalibration(options);
  uncorrected.arm = {};
  EXPECT_GT(mean(uncorrected), 3.5);
  EXPECT_LT(mean(found), 1.0);
  EXPECT_EQ(found.provenance.origin, core::Origin::kSimulated);
}

TEST(LineTrialRunnerTest, DemonstrationsAreUndisturbedAndStayAtTheLine) {
  ASSERT_EQ(Demonstrations().trajectories.size(), 10U);
  for (const core::Trajectory& trajectory : Demonstrations().trajectories) {
    EXPECT_EQ(trajectory.outcome, core::Outcome::kCompleted);
    EXPECT_EQ(trajectory.num_steps(), 50);
    // After its start, an arm with a good calibration deviates by some tenths of a mm.
    EXPECT_LT((trajectory.states.col(2).array() - trajectory.states(0, 2)).abs().maxCoeff(), 0.7);
    EXPECT_LT((trajectory.controls.rowwise().norm().array() - 0.5).abs().maxCoeff(), 0.01);
  }
}

TEST(LineTrialRunnerTest, SameSeedsGiveTheSameEpisode) {
  const std::vector<std::string> methods = {"baseline", "dfr"};
  const auto make = [&] {
    return LineTrialRunner(SmallModel(0.2), methods, FromTruth(),
                           test::PerfectCalibration(FromTruth()));
  };
  LineTrialRunner one = make();
  LineTrialRunner other = make();
  for (int method = 0; method < 2; ++method) {
    experiment::EpisodeResult a = one.Run(method, 2, 102);
    experiment::EpisodeResult b = other.Run(method, 2, 102);
    a.seconds = b.seconds = 0.0;
    EXPECT_EQ(a, b) << methods[static_cast<std::size_t>(method)];
  }
}

// If the platform never stops, a halt does not help: the line moves away from the tip.
TEST(LineTrialRunnerTest, InRealTimeAHaltMayCollide) {
  const std::vector<std::string> methods = {"early-stopping", "proportional"};
  std::array<int, 2> collided_after_halt{};
  std::array<int, 2> completed{};
  for (const std::string world : {"frozen", "30ms"}) {
    const bool frozen = world == "frozen";
    LineTrialRunner runner(SmallModel(0.2), methods, InWorld(FromTruth(), world),
                           test::PerfectCalibration(FromTruth()));
    for (std::uint64_t seed = 0; seed < 10; ++seed) {
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
  EXPECT_GE(collided_after_halt[1], 4);
  // A controller that observes the line follows it in both worlds.
  EXPECT_GE(completed[0], 9);
  EXPECT_GE(completed[1], 8);
}

TEST(LineTrialRunnerTest, UnknownWorldsAreNamed) {
  for (const char* world : {"", "fast", "ms", "-1ms", "30", "30msx"}) {
    EXPECT_THROW(static_cast<void>(InWorld(FromTruth(), world)), std::invalid_argument) << world;
  }
}

// A model read from a file is the same, bit for bit.
TEST(LineTrialRunnerTest, ModelsSurviveTheirFiles) {
  const test::TempFolder folder;
  const LineModel model = SmallModel(0.2);
  model.Save(folder.path);
  const LineModel loaded = LineModel::Load(folder.path);
  EXPECT_EQ(loaded.task().lambda(), model.task().lambda());
  const std::array<double, 4> x = {-20.0, 1.0, 0.2, 0.3};
  EXPECT_EQ(loaded.task().support().Decision(4, x), model.task().support().Decision(4, x));
  std::filesystem::remove(folder / "support.dfr");
  EXPECT_THROW(static_cast<void>(LineModel::Load(folder.path)), std::runtime_error);
}

// The system tier tests the goal of guided recovery over a hundred episodes.
TEST(LineTrialRunnerTest, GuidedRecoveryCompletesWhereTheLearnedPolicyCollides) {
  sim::LineTrackingOptions options = FromTruth();
  options.disturbance.between = true;
  LineTrialRunner runner(SmallModel(0.2), {"baseline", "controller"}, options,
                         test::PerfectCalibration(options));
  std::array<std::array<int, 3>, 2> counts{};
  for (std::uint64_t seed = 0; seed < 10; ++seed) {
    for (int method = 0; method < 2; ++method) {
      const auto outcome = runner.Run(method, core::DeriveSeed(2, {seed}), seed).outcome;
      ++counts[static_cast<std::size_t>(method)][static_cast<std::size_t>(outcome)];
    }
  }
  EXPECT_GE(counts[1][static_cast<std::size_t>(core::Outcome::kCompleted)], 9);
  EXPECT_EQ(counts[1][static_cast<std::size_t>(core::Outcome::kCollided)], 0);
  EXPECT_GE(counts[0][static_cast<std::size_t>(core::Outcome::kCollided)], 5);
}

TEST(LineTrialRunnerTest, TooFewDemonstrationsThrow) {
  imitation::DemonstrationSet set = Demonstrations();
  set.trajectories.resize(4);
  EXPECT_THROW(static_cast<void>(LineModel::Fit(set, {})), std::invalid_argument);
}

// Compares each probe with its effect: with exact states all signs are correct, and the fine probes
// are 50 times shorter.
TEST(ProbeStudyTest, ExactStatesHaveNoWrongSigns) {
  LineTrialRunner runner(SmallModel(0.05), {"dfr", "dfr-fine"}, FromTruth(),
                         test::PerfectCalibration(FromTruth()));
  std::array<double, 2> sizes{};
  for (const int method : {0, 1}) {
    ProbeStudy study(runner.model(), runner.plant());
    EXPECT_TRUE(std::isnan(study.right_sign()));
    for (std::uint64_t seed = 0; seed < 3; ++seed)
      runner.RunObserved(method, seed, seed, &study, 100);
    ASSERT_GT(study.probes(), 10);
    EXPECT_EQ(study.right_sign(), 1.0);
    EXPECT_EQ(study.error_um(), 0.0);
    EXPECT_GE(study.recoveries(), study.ended());
    EXPECT_GE(study.recoveries(), study.out_of_reach());
    sizes[static_cast<std::size_t>(method)] = study.size_um();
  }
  // The ratio is not exactly 50, because the states differ.
  EXPECT_GT(sizes[0], 20.0 * sizes[1]);
}

}  // namespace
}  // namespace dfr::apps::line_tracking
