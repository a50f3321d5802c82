// Episodes of line tracking with a camera and rendered pictures.
#include <gtest/gtest.h>

#include <memory>
#include <string>

#include "dfr/experiment/paired_evaluation.h"
#include "tests/line_tracking/demonstrations.h"

namespace dfr::apps::line_tracking {
namespace {

using sim::LineTrackingPlant;

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

// LineTrackingPicturesTest tests all faults.
TEST(CameraEpisodesTest, ABlindCameraHaltsTheEpisode) {
  const sim::LineTrackingOptions options;
  const line_task::LineCalibration known = test::PerfectCalibration(options);
  LineTrackingPlant plant(options, &known);
  const LineModel model = SmallModel(0.5);
  const auto controller = model.MakeController("baseline");
  Saboteur saboteur(plant, sim::CameraFault::kFrozen);
  const control::RolloutResult result =
      control::Rollout(plant, *controller, {.plant_seed = 1}, &saboteur);
  EXPECT_EQ(result.outcome, core::Outcome::kHalted);
  EXPECT_EQ(result.halt_cause, control::HaltCause::kStateInvalid);
  EXPECT_EQ(result.policy_steps, 4);
}

// The result names the feature that is missing in the picture.
TEST(CameraEpisodesTest, IntrinsicsOfAnotherCameraHaltTheEpisode) {
  const sim::LineTrackingOptions options;
  line_task::LineCalibration foreign = test::PerfectCalibration(options);
  foreign.camera.fx *= 1.5;
  foreign.camera.fy *= 1.5;
  LineTrialRunner runner(SmallModel(0.5), {"baseline", "controller"}, options, foreign);
  for (const int method : {0, 1}) {
    const experiment::EpisodeResult result = runner.Run(method, 1, 1);
    EXPECT_EQ(result.outcome, core::Outcome::kHalted);
    EXPECT_EQ(result.cause,
              std::string("not-seen-") + vision::Name(runner.plant().last_observation().missing));
    EXPECT_NE(runner.plant().last_observation().missing, vision::NotSeen::kNothing);
  }
}

// Each thread has a separate OpenGL context.
TEST(CameraEpisodesTest, TheNumberOfThreadsDoesNotMatter) {
  const sim::LineTrackingOptions options = Disturbed();
  const experiment::EvaluationPlan plan{.methods = {"baseline"},
                                        .learners = {"8"},
                                        .demonstrations = {10},
                                        .trials = 2,
                                        .episodes = 1,
                                        .seed = 5};
  const auto make = [&](const experiment::EvaluationUnit& /*unit*/) {
    return std::make_unique<LineTrialRunner>(SmallModel(0.5), plan.methods, options,
                                             test::PerfectCalibration(options));
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

}  // namespace
}  // namespace dfr::apps::line_tracking
