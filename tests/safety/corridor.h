#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/random.h"
#include "dfr/core/trajectory.h"

namespace dfr::test {

inline constexpr double kSpeed = 0.1;

/// State: "clock" (1), which no feature should use, and "tip" (2). The tip moves right by kSpeed
/// per step along y = 0, with a spread of about 0.1. Actions are its change, turned by kTurn.
inline core::StateLayout CorridorLayout() {
  core::StateLayout layout;
  layout.Add("clock", 1);
  layout.Add("tip", 2);
  return layout;
}

inline constexpr double kTurn = 0.8;

/// Effect of action `u` on the tip.
inline Eigen::Vector2d Effect(double u0, double u1) {
  return {std::cos(kTurn) * u0 - std::sin(kTurn) * u1, std::sin(kTurn) * u0 + std::cos(kTurn) * u1};
}
/// Returns the action that moves the tip by (dx, dy).
inline Eigen::Vector2d ActionFor(double dx, double dy) {
  return {std::cos(kTurn) * dx + std::sin(kTurn) * dy,
          -std::sin(kTurn) * dx + std::cos(kTurn) * dy};
}

inline std::vector<core::Trajectory> CorridorDemonstrations(std::uint64_t seed, int count,
                                                            int steps = 20) {
  core::Random random(seed);
  std::vector<core::Trajectory> demonstrations;
  for (int d = 0; d < count; ++d) {
    core::Trajectory demonstration;
    demonstration.states.resize(steps + 1, 3);
    demonstration.controls.resize(steps, 2);
    demonstration.states.row(0) << 0.0, 0.05 * random.Normal(), 0.1 * random.Normal();
    for (int t = 0; t < steps; ++t) {
      const double dy = -0.3 * demonstration.states(t, 2) + 0.05 * random.Normal();
      demonstration.states.row(t + 1) << t + 1.0, demonstration.states(t, 1) + kSpeed,
          demonstration.states(t, 2) + dy;
      demonstration.controls.row(t) = ActionFor(kSpeed, dy).transpose();
    }
    demonstration.outcome = core::Outcome::kCompleted;
    demonstrations.push_back(demonstration);
  }
  return demonstrations;
}

/// A tip that moves according to Effect().
struct CorridorPlant {
  std::vector<double> x = {0.0, 0.0, 0.0};
  void Apply(const std::vector<double>& u) {
    const Eigen::Vector2d move = Effect(u[0], u[1]);
    x[0] += 1.0;
    x[1] += move[0];
    x[2] += move[1];
  }
};

}  // namespace dfr::test
