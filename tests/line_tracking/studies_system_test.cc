// The claims of line tracking's studies.
#include <gtest/gtest.h>

#include <array>
#include <cstdint>

#include "dfr/core/random.h"
#include "tests/line_tracking/scene.h"
#include "tests/sim_line_tracking/perfect_calibration.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

// Results of the paper's robot: at least twice the completions of Baseline, and 84 % fewer
// collisions. With exact states, both choices of the two constants that Algorithm 1 leaves open
// achieve these results. With too narrow a kernel neither choice achieves them, because g stays
// below the gate. Ratios of counts need 40 episodes of each method.
TEST(ProbeStudyTest, DfrDoublesCompletionsAndRemovesCollisions) {
  const imitation::DemonstrationSet set =
      Demonstrate(FromTruth(), test::PerfectCalibration(FromTruth()), 50, 50, 1);
  for (const double gamma : {0.02, 0.1}) {
    SCOPED_TRACE(gamma);
    LineModelOptions model;
    model.hidden = {16};
    model.gammas = {gamma};
    LineTrialRunner runner(LineModel::Fit(set, model), {"baseline", "dfr", "dfr-fine"}, FromTruth(),
                           test::PerfectCalibration(FromTruth()));
    std::array<int, 3> completed{};
    std::array<int, 3> collided{};
    for (std::uint64_t seed = 0, accepted = 0; accepted < 40; ++seed) {
      const std::uint64_t start = core::DeriveSeed(3, {seed});
      if (!runner.Accepts(start)) continue;
      ++accepted;
      for (std::size_t method = 0; method < 3; ++method) {
        const auto outcome = runner.Run(static_cast<int>(method), start, seed).outcome;
        if (outcome == core::Outcome::kCompleted) ++completed[method];
        if (outcome == core::Outcome::kCollided) ++collided[method];
      }
    }
    ASSERT_GE(completed[0], 5);
    ASSERT_GE(collided[0], 20);
    for (const std::size_t method : {1U, 2U}) {
      EXPECT_LE(collided[method], 0.16 * collided[0]) << method;
      if (gamma < 0.05) {
        EXPECT_GE(completed[method], 2 * completed[0]) << method;
      } else {
        EXPECT_EQ(completed[method], 0) << method;
      }
    }
  }
}

// The goal of guided recovery, even if the platform continues to move after every control: 95 %
// completed, 2 % collided. A method that completes 98 % would miss the goal in 5 % of runs of 100
// episodes, but the seeds are fixed.
TEST(LineTrialRunnerTest, GuidedRecoveryCompletesOnAMovingPlatform) {
  for (const bool between : {false, true}) {
    SCOPED_TRACE(between);
    sim::LineTrackingOptions options = FromTruth();
    options.disturbance.between = between;
    LineModelOptions model;
    model.hidden = {16};
    model.gammas = {0.1};
    LineTrialRunner runner(
        LineModel::Fit(Demonstrate(options, test::PerfectCalibration(options), 50, 50, 1), model),
        {"baseline", "controller"}, options, test::PerfectCalibration(options));
    std::array<std::array<int, 3>, 2> counts{};
    for (std::uint64_t seed = 0; seed < 100; ++seed) {
      for (int method = 0; method < 2; ++method) {
        const auto outcome = runner.Run(method, core::DeriveSeed(2, {seed}), seed).outcome;
        ++counts[static_cast<std::size_t>(method)][static_cast<std::size_t>(outcome)];
      }
    }
    EXPECT_GE(counts[1][static_cast<std::size_t>(core::Outcome::kCompleted)], 95);
    EXPECT_LE(counts[1][static_cast<std::size_t>(core::Outcome::kCollided)], 2);
    // Without recovery most episodes collide, which proves that the platform disturbs them.
    EXPECT_GE(counts[0][static_cast<std::size_t>(core::Outcome::kCollided)], 50);
  }
}

}  // namespace
}  // namespace dfr::apps::line_tracking
