#include <gtest/gtest.h>

#include <vector>

#include "dfr/control/constants.h"
#include "dfr/control/guided/safety_filter.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/matrix.h"
#include "tests/control/analytic.h"
#include "tests/control/rightwards.h"
#include "tests/control/task.h"

namespace dfr::control {
namespace {

// A state to the right of a disk that moves to the right, as the demonstrated controls do. A raise
// moves the state to the left. World: at rest, or moves upwards by itself.
class SharedSignsTest : public testing::Test {
 protected:
  // Returns the corrected control in the state (x, 0), and its level in `level`.
  Eigen::VectorXd Corrected(bool rests, double x, double learned, double& level) {
    std::vector<core::Trajectory> demonstrations = test::Rightwards();
    for (std::size_t d = 0; d < demonstrations.size(); ++d) {
      const double speed = test::kSpeed * (0.5 + static_cast<double>(d) / 30.0);
      demonstrations[d].controls.col(0).setConstant(speed);
      for (int t = 0; t <= test::kSteps; ++t) {
        demonstrations[d].states(t, 0) = speed * t;
        if (!rests) demonstrations[d].states(t, 1) += test::kSpeed * t;
      }
    }
    const test::Task task{test::IdentityFeatures(), support_, demonstrations};
    const ResponseEstimate estimate(task.response.prior(), {}, true);
    LocalFit fit = estimate.FitAt(0, std::vector{x, 0.0});
    Eigen::VectorXd demonstrated(2);
    EXPECT_TRUE(fit.NominalControl(demonstrated));
    EXPECT_GT(demonstrated[0], guided::kClearSign);
    Eigen::VectorXd v = Eigen::Vector2d(learned, 0.0);
    SafetyFilter filter(
        task,
        {.control_limit = {2.0 * test::kSpeed}, .least_intervention = true, .probe_size = 0.0});
    const auto choice = filter.Filter(fit, {1, task.levels.gate(1)}, 0.0, v);
    EXPECT_LT(choice.learned, 0.0);
    level = choice.level;
    return v;
  }

  test::GaussianSupport support_ = test::MovingDisk();
};

TEST_F(SharedSignsTest, ARaiseThatEndsOutsideKeepsThemInAMovingWorld) {
  constexpr double kFar = 1.0;
  double level = 0.0;
  for (const double learned : {0.5 * guided::kClearSign, -0.5, 0.5}) {
    EXPECT_LT(Corrected(true, kFar, learned, level)[0], -guided::kClearSign) << learned;
    EXPECT_LT(level, 0.0);
    const double v = Corrected(false, kFar, learned, level)[0];
    EXPECT_LT(level, 0.0);
    if (learned > guided::kClearSign) {
      EXPECT_GT(v, 0.99 * learned) << "less than both controls";
    } else {
      EXPECT_LT(v, -guided::kClearSign) << learned;
    }
  }
}

TEST_F(SharedSignsTest, ARaiseThatEndsInsideMayReverseThem) {
  double level = 0.0;
  for (const bool rests : {true, false}) {
    EXPECT_LT(Corrected(rests, 0.62, 0.5, level)[0], -guided::kClearSign) << rests;
    EXPECT_GE(level, 0.0) << rests;
  }
}

}  // namespace
}  // namespace dfr::control
