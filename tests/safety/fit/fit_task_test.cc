#include "fit/fit_task.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <utility>
#include <vector>

#include "dfr/control/phase_tracker.h"
#include "dfr/core/numerics/folds.h"
#include "dfr/core/random.h"
#include "dfr/kernel/whitened_support.h"
#include "tests/safety/corridor.h"

namespace dfr::safety {
namespace {

core::FeatureSelection Tip() { return {test::CorridorLayout(), "tip"}; }

// The kernel is so narrow that the slack of demonstrations exceeds the minimum.
constexpr double kNarrow = 20.0;

// Returns l of each state under a support of the other folds, at the phase of a phase tracker.
std::vector<double> UnseenLevels(const std::vector<core::Matrix>& points,
                                 const kernel::WhitenedSupportOptions& options, int folds) {
  std::vector<std::size_t> order(points.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const core::Folds left_out = core::StratifiedFolds(points, folds);
  std::vector<double> levels;
  for (std::size_t fold = 0; fold < left_out.size(); ++fold) {
    std::vector<core::Matrix> others;
    for (const std::size_t d : core::Others(left_out, fold, order)) others.push_back(points[d]);
    const auto support = kernel::WhitenedSupport::Fit(others, options);
    for (const std::size_t d : left_out[fold]) {
      control::PhaseTracker tracker(support);
      for (Eigen::Index t = 0; t < points[d].rows(); ++t) {
        levels.push_back(tracker.Follow(core::Row(points[d], t)));
      }
    }
  }
  return levels;
}

// Builds the expected model from the parts named in docs/recovery.md.
TEST(FitTaskTest, CombinesThePartsOfTheLibraries) {
  const auto demonstrations = test::CorridorDemonstrations(3, 12);
  const kernel::WhitenedSupportOptions options{.svm = {.gamma = kNarrow}};
  const TaskModel model(test::CorridorLayout(), demonstrations,
                        {.guided_features = "tip", .guided = options});

  std::vector<core::Matrix> states;
  states.reserve(demonstrations.size());
  for (const auto& d : core::InDeterministicOrder(demonstrations)) states.push_back(d.states);
  const auto features = core::FeatureTransform::Whitening(Tip(), states);
  const control::FeatureTrajectories seen(features, core::InDeterministicOrder(demonstrations));
  const auto support = kernel::WhitenedSupport::Fit(seen.points, options);
  const control::Levels levels(
      support, seen.points,
      {.slack = control::EstimateSlack(UnseenLevels(seen.points, options, 5))});
  const control::Response response(seen);

  EXPECT_EQ(model.features().scale(), features.scale());
  EXPECT_EQ(model.levels().slack(), levels.slack());
  EXPECT_GT(model.levels().slack(), control::LevelOptions().slack)
      << "at the minimum, the estimate would have no effect";
  EXPECT_EQ(model.response().largest_control(), response.largest_control());
  for (const int t : {0, 7, 20}) {
    EXPECT_EQ(model.levels().gate(t), levels.gate(t));
    EXPECT_LT(model.levels().median(t), levels.gate(t));
    for (const double x : {-0.3, 0.0, 1.1}) {
      const std::vector<double> z = {x, 0.2};
      EXPECT_EQ(model.feature_support().Decision(t, z), support.Decision(t, z));
    }
  }
}

// Returns the fit of a guard that may narrow its kernel.
internal::GuardFit FitOf(const core::FeatureSelection& features,
                         const std::vector<core::Trajectory>& demonstrations,
                         const kernel::WhitenedSupportOptions& options, int folds = 5) {
  const internal::Recorded recorded(features, demonstrations,
                                    core::DeterministicOrder(demonstrations));
  return internal::FitGuard(
             recorded, options, folds, [](std::string_view, double) { return true; }, true)
      .value();
}

// A support needs two demonstrations: for any requested number of folds, the fit leaves out at most
// two of four at a time, and one of three.
TEST(FitTaskTest, EachStateHasALevelIfTwoDemonstrationsRemain) {
  for (const auto& [count, states] : {std::pair(12, 12), std::pair(4, 4), std::pair(3, 1)}) {
    const auto demonstrations = test::CorridorDemonstrations(3, count);
    const internal::GuardFit fit = FitOf(Tip(), demonstrations, {.window_share = 1.0}, 9);
    EXPECT_EQ(std::ssize(fit.left_out.worst), states) << count;
    const std::vector<double> levels = fit.left_out.levels();
    EXPECT_EQ(std::ssize(levels), states * demonstrations[0].states.rows()) << count;
    EXPECT_EQ(std::ranges::max(fit.left_out.worst), -std::ranges::min(levels));
  }
}

// Returns paths to the right. Across the path, their positions are in a ring of radii `hole` and 2.
std::vector<core::Trajectory> AroundAHole(double hole, std::uint64_t seed) {
  constexpr int kSteps = 12;
  core::Random random(seed);
  std::vector<core::Trajectory> demonstrations;
  while (demonstrations.size() < 60) {
    const double y = random.Uniform(-2.0, 2.0);
    const double z = random.Uniform(-2.0, 2.0);
    if (std::hypot(y, z) < hole || std::hypot(y, z) > 2.0) continue;
    core::Trajectory& demonstration = demonstrations.emplace_back();
    demonstration.states.resize(kSteps + 1, 3);
    demonstration.controls = core::Matrix::Constant(kSteps, 1, 0.2);
    for (int t = 0; t <= kSteps; ++t) demonstration.states.row(t) << 0.2 * t, y, z;
  }
  return demonstrations;
}

TEST(FitTaskTest, ARegionThatDemonstrationsAvoidDoublesGamma) {
  core::StateLayout layout;
  layout.Add("tip", 3);
  for (const double hole : {0.0, 1.6}) {
    EXPECT_EQ(FitOf({layout, "tip"}, AroundAHole(hole, 1), {}).options.svm.gamma,
              hole > 0.0 ? 0.5 : 0.25)
        << hole;
  }
}

// Demonstrations move along a circle with different speeds: the states of a time step lie on an
// arc. A narrower kernel covers as many left-out states and less space beside the arc. A still
// narrower kernel covers fewer left-out states.
TEST(FitTaskTest, StatesOnAnArcDoubleGamma) {
  constexpr int kSteps = 24;
  core::StateLayout layout;
  layout.Add("tip", 2);
  core::Random random(3);
  std::vector<core::Trajectory> demonstrations;
  for (int d = 0; d < 60; ++d) {
    const double speed = random.Uniform(0.03, 0.12);
    const double radius = 1.0 + 0.04 * random.Normal();
    core::Trajectory& demonstration = demonstrations.emplace_back();
    demonstration.states.resize(kSteps + 1, 2);
    for (int t = 0; t <= kSteps; ++t) {
      const double angle = speed * t;
      demonstration.states.row(t) << radius * std::cos(angle), radius * std::sin(angle);
    }
    demonstration.controls =
        demonstration.states.bottomRows(kSteps) - demonstration.states.topRows(kSteps);
  }
  for (const double gamma : {0.25, 1.0}) {
    const auto fit = FitOf({layout, "tip"}, demonstrations, {.svm = {.gamma = gamma}});
    EXPECT_EQ(fit.options.svm.gamma, gamma < 1.0 ? 2.0 * gamma : gamma);
  }
}

TEST(FitTaskTest, ContiguousFoldsFollowTheRecording) {
  const auto demonstrations = test::CorridorDemonstrations(3, 12);
  const auto order = core::DeterministicOrder(demonstrations);
  const internal::Recorded recorded(Tip(), demonstrations, std::span(order).subspan(2));
  EXPECT_EQ(recorded.seen.points.size(), 10u);
  int next = 0;
  for (const auto& fold : recorded.Contiguous(5)) {
    EXPECT_EQ(fold.size(), 2u);
    for (const std::size_t d : fold) {
      const int recorded_as = static_cast<int>(order[d + 2]);
      EXPECT_GE(recorded_as, next);
      next = recorded_as + 1;
      EXPECT_EQ(recorded.ordered[d].states, demonstrations[order[d + 2]].states);
    }
  }
}

}  // namespace
}  // namespace dfr::safety
