#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/policy.h"
#include "dfr/core/random.h"
#include "dfr/core/trajectory.h"

namespace dfr::test {

inline constexpr double kSpeed = 0.1;

/// State: "clock" (1), which no feature should use, and "tip" (2). The tip moves right by kSpeed
/// per step along y = 0, with a spread of about 0.1. Actions are the change of the tip, turned by
/// kTurn.
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

/// The corridor with irregular steps: actions differ from each other in all entries, and do not
/// explain the clock.
inline std::vector<core::Trajectory> IrregularDemonstrations(int count, core::Random& random) {
  std::vector<core::Trajectory> demonstrations = CorridorDemonstrations(1, count);
  for (core::Trajectory& d : demonstrations) {
    for (Eigen::Index t = 0; t < d.controls.rows(); ++t) {
      const double dx = kSpeed * (1.0 + 0.5 * random.Normal());
      const double dy = d.states(t + 1, 2) - d.states(t, 2);
      d.states(t + 1, 1) = d.states(t, 1) + dx;
      d.controls.row(t) = ActionFor(dx, dy).transpose();
    }
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

/// The same action in every state.
class ConstantPolicy final : public core::Policy {
 public:
  explicit ConstantPolicy(std::vector<double> action) : action_(std::move(action)) {}
  [[nodiscard]] int state_dim() const noexcept override { return 3; }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  void Control(int, std::span<const double>, std::span<double> u) const noexcept override {
    std::copy(action_.begin(), action_.end(), u.begin());
  }

 private:
  std::vector<double> action_;
};

}  // namespace dfr::test
