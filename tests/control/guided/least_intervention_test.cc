#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "dfr/control/constants.h"
#include "dfr/control/guided/safety_filter.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "tests/control/analytic.h"
#include "tests/control/rightwards.h"
#include "tests/control/task.h"

namespace dfr::control {
namespace {

using Choice = SafetyFilter::Choice;

// Learned controls whose predicted levels decrease from inside the next support to far outside. All
// corrections end inside.
TEST(LeastInterventionTest, InAWorldAtRestTheLearnedControlPassesSlightlyOutside) {
  const test::GaussianSupport support = test::MovingDisk();
  for (const bool moves : {false, true}) {
    auto demonstrations = test::Rightwards();
    for (core::Trajectory& demonstration : demonstrations) {
      demonstration.controls.col(0).array() += moves ? -0.7 * test::kSpeed : 0.0;
    }
    test::Task task{test::IdentityFeatures(), support, demonstrations};
    for (const auto& [depth, error] :
         std::vector<std::pair<double, double>>{{0.05, 9.0}, {9.0, 9.0}, {9.0, 0.03}}) {
      task.levels.SetHeldOut(std::vector{HeldOutLevels{.levels = {-depth}, .phases = {0}}});
      task.levels.SetPredictionErrors(std::vector{error});
      for (const bool least : {true, false}) {
        for (const bool disturbed : {false, true}) {
          GuidedOptions options{.least_intervention = least, .probe_size = 0.0};
          if (disturbed) options.disturbance_model = {.base = 0.5, .per_control = 1.0};
          const Eigen::Vector2d z(0.0, 0.3);
          LocalFit fit =
              ResponseEstimate(task.response.prior(), {}, moves).FitAt(0, core::AsSpan(z));
          const LocalModel local{support, fit};
          SafetyFilter filter(task, options);
          const double shallow = guided::kShallowDepth * filter.max_exit_level();
          const double lowest = -std::min({depth, error, shallow});
          const double most = least && !disturbed && !moves ? lowest : 0.0;
          int passed = 0;
          int changed = 0;
          for (double up = -12.0; up < 12.0; up += 0.05) {
            const Eigen::VectorXd learned = Eigen::Vector2d(1.0, up);
            const double level = local.Level(1, learned);
            // In the moving world, a change that gains nothing is not made within the exit level.
            const double skipped = moves ? 0.5 : 0.02;
            if (level < most + 1e-3 && level > most - skipped) continue;
            Eigen::VectorXd v = learned;
            const Choice choice = filter.Filter(fit, {1, 0.01}, 0.0, v);
            const bool passes = level >= most;
            EXPECT_EQ(choice.mode == Mode::kPolicy && v == learned, passes)
                << moves << depth << least << disturbed << " " << up << " " << level;
            (passes ? passed : changed) += 1;
          }
          EXPECT_GT(passed, 10) << moves << depth << least << disturbed;
          EXPECT_GT(changed, 10) << moves << depth << least << disturbed;
        }
      }
    }
  }
}

// Demonstrations move up and down by a hundredth of their speed to the right.
TEST(LeastInterventionTest, AnAscentKeepsToDemonstratedSizesUnlessTheStateIsFarOutside) {
  auto demonstrations = test::Rightwards();
  core::Random random(3);
  for (core::Trajectory& demonstration : demonstrations) {
    demonstration.states.col(1).setZero();
    for (Eigen::Index t = 0; t < demonstration.controls.rows(); ++t) {
      const double y = 0.01 * test::kSpeed * random.Normal();
      demonstration.controls(t, 1) = y;
      demonstration.states(t + 1, 1) = demonstration.states(t, 1) + y;
    }
  }
  const test::GaussianSupport support = test::MovingDisk();
  test::Task task{test::IdentityFeatures(), support, demonstrations};
  task.levels.SetHeldOut(std::vector{HeldOutLevels{.levels = {-0.1}, .phases = {0}}});
  const ResponseEstimate estimate(task.response.prior());
  // The levels of the three states are about .4, -.05 and -.3.
  for (const double y : {0.27, 0.43, 0.5}) {
    const Eigen::Vector2d z(0.0, y);
    LocalFit fit = estimate.FitAt(0, core::AsSpan(z));
    const LocalModel local{support, fit};
    double squares = 0.0;
    for (const core::Trajectory& demonstration : demonstrations) {
      squares += demonstration.controls.topRows(6).col(1).squaredNorm() / 180.0;
    }
    const double size = fit.DemonstratedSize(1);
    EXPECT_NEAR(size, std::sqrt(squares) / task.response.control_unit(), 0.3 * size);
    const auto raised = [&](bool least) {
      Eigen::VectorXd v = Eigen::Vector2d(1.0, 0.5);
      const GuidedOptions options{
          .least_intervention = least, .probe_size = 0.0, .demonstrated = false};
      const Choice choice = SafetyFilter(task, options).Filter(fit, {1, 0.6}, 0.6, v);
      EXPECT_EQ(choice.level, local.Level(1, v));
      return v[1];
    };
    EXPECT_LT(raised(false), -2.0 * guided::kLocalReach * size);
    if (support.LogDecision(0, core::AsSpan(z), {}) >= -0.1) {
      EXPECT_LE(std::abs(raised(true)), guided::kLocalReach * size) << y;
    } else {
      EXPECT_LT(raised(true), -2.0 * guided::kLocalReach * size) << y;
    }
  }
}

}  // namespace
}  // namespace dfr::control
