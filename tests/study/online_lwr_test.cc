#include "dfr/study/online_lwr.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/no_alloc.h"

namespace dfr::study {
namespace {

constexpr int kSteps = 10;
constexpr double kGain = 0.1;

std::span<const double> In(const Eigen::Vector2d& x) { return {x.data(), 2}; }

// Returns the position of a point after a control: it moves by kGain times the rotated control.
Eigen::Vector2d Moved(const Eigen::Vector2d& x, const Eigen::Vector2d& u, double turn = 0.0) {
  return x + kGain * (Eigen::Rotation2Dd(turn) * u);
}

// Returns few demonstrations: all transitions in the window are among the nearest.
std::vector<core::Trajectory> Demonstrations() {
  std::vector<core::Trajectory> demonstrations;
  core::Random random(3);
  for (int d = 0; d < 5; ++d) {
    core::Trajectory trajectory;
    trajectory.states.resize(kSteps + 1, 2);
    trajectory.controls.resize(kSteps, 2);
    Eigen::Vector2d x(0.0, random.Uniform(-0.3, 0.3));
    for (int t = 0; t < kSteps; ++t) {
      trajectory.states.row(t) = x.transpose();
      const Eigen::Vector2d u(0.6 + 0.1 * random.Normal(), -x[1] + 0.1 * random.Normal());
      trajectory.controls.row(t) = u.transpose();
      x = Moved(x, u);
    }
    trajectory.states.row(kSteps) = x.transpose();
    demonstrations.push_back(std::move(trajectory));
  }
  return demonstrations;
}

core::FeatureTransform Features() {
  return core::FeatureTransform::Identity(core::FeatureSelection::All(2));
}

OnlineLwrPolicy MakePolicy() {
  return {Features(),
          control::Response(control::FeatureTrajectories(Features(), Demonstrations()))};
}

Eigen::Vector2d ControlOf(const OnlineLwrPolicy& policy, int t, const Eigen::Vector2d& x) {
  Eigen::Vector2d u;
  policy.Control(t, In(x), {u.data(), 2});
  return u;
}

// Computes weighted least squares from the definition, with guided recovery's kernel width and
// ridge.
Eigen::Vector2d Lwr(int t, const Eigen::Vector2d& x) {
  const std::vector<core::Trajectory> demonstrations = Demonstrations();
  double nearest = std::numeric_limits<double>::infinity();
  const auto each = [&](const auto& visit) {
    for (const core::Trajectory& d : demonstrations) {
      for (int k = std::max(0, t - 5); k <= std::min(kSteps - 1, t + 5); ++k) {
        visit(Eigen::Vector2d(d.states.row(k)) - x, Eigen::Vector2d(d.controls.row(k)));
      }
    }
  };
  each([&](const Eigen::Vector2d& y, const Eigen::Vector2d&) {
    nearest = std::min(nearest, y.squaredNorm());
  });
  Eigen::Matrix3d a = Eigen::Matrix3d::Zero();
  Eigen::Matrix<double, 3, 2> b = Eigen::Matrix<double, 3, 2>::Zero();
  each([&](const Eigen::Vector2d& y, const Eigen::Vector2d& u) {
    const double weight = std::exp(-0.5 * (y.squaredNorm() - nearest) / 2.0);
    const Eigen::Vector3d row(y[0], y[1], 1.0);
    a += weight * row * row.transpose();
    b += weight * row * u.transpose();
  });
  a.diagonal().head<2>().array() += 0.1 * a(2, 2);
  const Eigen::Matrix<double, 3, 2> solution = a.llt().solve(b);
  return solution.row(2).transpose();
}

TEST(OnlineLwrTest, WithoutRotationItIsLocallyWeightedRegressionAndAllocatesNothing) {
  OnlineLwrPolicy policy = MakePolicy();
  Eigen::Vector2d x(0.0, 0.2);
  for (int t = 0; t < kSteps; ++t) {
    Eigen::Vector2d u;
    {
      const test::NoAlloc none;
      policy.See(In(x));
      policy.Control(t, In(x), {u.data(), 2});
      policy.Applied(In(u));
    }
    EXPECT_NEAR((u - Lwr(t, x)).norm(), 0.0, 0.02) << "time step " << t;
    x = Moved(x, u);
  }
}

TEST(OnlineLwrTest, CompensatesRotatedControls) {
  constexpr double kTurn = 40.0 * M_PI / 180.0;
  OnlineLwrPolicy policy = MakePolicy();
  core::Random random(5);
  const Eigen::Vector2d x(0.3, 0.1);
  const auto error = [&] {
    const Eigen::Vector2d wanted = Moved(x, Lwr(5, x)) - x;
    return (Moved(x, ControlOf(policy, 5, x), kTurn) - x - wanted).norm() / wanted.norm();
  };
  const double before = error();
  EXPECT_GT(before, 0.5);  // 2 sin 20 degrees = .68
  for (int i = 0; i < 60; ++i) {
    const Eigen::Vector2d u(0.6 + 0.2 * random.Normal(), 0.4 * random.Normal());
    policy.See(In(x));
    policy.Applied(In(u));
    const Eigen::Vector2d there = Moved(x, u, kTurn);
    policy.See(In(there));
  }
  EXPECT_LT(error(), 0.6 * before);
  policy.Reset();
  EXPECT_EQ(error(), before);
}

TEST(OnlineLwrTest, AStateThatIsNotFiniteHasNoControl) {
  const OnlineLwrPolicy policy = MakePolicy();
  const Eigen::Vector2d u = ControlOf(policy, 0, {std::numeric_limits<double>::quiet_NaN(), 0.0});
  EXPECT_TRUE(std::isnan(u[0]) && std::isnan(u[1]));
}

}  // namespace
}  // namespace dfr::study
