#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/random.h"
#include "dfr/core/trajectory.h"
#include "tests/control/analytic.h"
#include "tests/control/task.h"

/// A task of guided recovery that can be computed by hand: a point and its supports move right.
namespace dfr::test {

inline constexpr double kSpeed = 0.1;
inline constexpr int kSteps = 20;

/// Demonstrations of a point that moves right by kSpeed per step, with scattered y. The change of
/// state is the control, turned by `angle`.
inline std::vector<core::Trajectory> Rightwards(double angle = 0.0) {
  core::Random random(1);
  std::vector<core::Trajectory> demonstrations;
  for (int d = 0; d < 30; ++d) {
    core::Trajectory trajectory;
    trajectory.states.resize(kSteps + 1, 2);
    trajectory.controls.resize(kSteps, 2);
    trajectory.states.row(0) << 0.05 * random.Normal(), 0.1 * random.Normal();
    for (int t = 0; t < kSteps; ++t) {
      const double dx = kSpeed;
      const double dy = -0.3 * trajectory.states(t, 1) + 0.05 * random.Normal();
      trajectory.states.row(t + 1) = trajectory.states.row(t) + Eigen::RowVector2d(dx, dy);
      trajectory.controls.row(t) << std::cos(angle) * dx + std::sin(angle) * dy,
          -std::sin(angle) * dx + std::cos(angle) * dy;
    }
    demonstrations.push_back(trajectory);
  }
  return demonstrations;
}

/// Rightwards() with pauses: the first entry of a control is kSpeed or, in every third step, 0.
inline std::vector<core::Trajectory> RightwardsOrStill() {
  std::vector<core::Trajectory> demonstrations = Rightwards();
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    for (int t = 0; t < kSteps; ++t) {
      const double speed = (static_cast<std::size_t>(t) + d) % 3 == 0 ? 0.0 : kSpeed;
      demonstrations[d].controls(t, 0) = speed;
      demonstrations[d].states(t + 1, 0) = demonstrations[d].states(t, 0) + speed;
    }
  }
  return demonstrations;
}

/// B_t is a disk of radius 0.42 around (t kSpeed, 0): l_t(x) = log 2 - 4 |x - (t kSpeed, 0)|^2.
inline GaussianSupport MovingDisk() { return {{{0.0, 0.0}}, 4.0, 0.5, {kSpeed, 0.0}, kSteps + 1}; }

inline core::FeatureTransform IdentityFeatures(int dim = 2) {
  return core::FeatureTransform::Identity(core::FeatureSelection::All(dim));
}

/// A point that turns its control by `angle`, as Rightwards() does.
struct TurnedPoint {
  double angle = 0.0;
  std::vector<double> x = {0.0, 0.0};
  void Apply(const std::vector<double>& u) {
    x[0] += std::cos(angle) * u[0] - std::sin(angle) * u[1];
    x[1] += std::sin(angle) * u[0] + std::cos(angle) * u[1];
  }
};

/// A fixture with the task of Rightwards() and the supports of MovingDisk().
class RightwardsTest : public testing::Test {
 protected:
  const GaussianSupport support = MovingDisk();
  const Task model{IdentityFeatures(), support, Rightwards()};
  std::vector<double> u = {0.0, 0.0};  ///< The control of the last step.

  /// Starts an episode in state x.
  control::Step First(control::Controller& controller, const std::vector<double>& x) {
    controller.Reset(1);
    return controller.Next(x, u);
  }
};

}  // namespace dfr::test
