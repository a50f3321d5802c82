#pragma once

#include <cmath>
#include <cstdint>
#include <span>

#include "dfr/core/plant.h"
#include "dfr/core/random.h"
#include "dfr/imitation/trpo.h"

namespace dfr::test {

/// A point in the plane that moves by a tenth of the control, and a goal to reach. Collides on
/// leaving the square of side 4.
class PointPlant final : public core::Plant {
 public:
  PointPlant() {
    layout_.Add("point", 2);
    layout_.Add("goal", 2);
  }
  const core::StateLayout& layout() const noexcept override { return layout_; }
  int control_dim() const noexcept override { return 2; }
  void Reset(std::uint64_t seed) override {
    core::Random random(seed);
    for (double& entry : state_) entry = random.Uniform(-1.0, 1.0);
  }
  core::PlantStatus Apply(std::span<const double> control) noexcept override {
    state_[0] += 0.1 * control[0];
    state_[1] += 0.1 * control[1];
    return core::PlantStatus::kOk;
  }
  void Observe(std::span<double> state) const noexcept override {
    for (std::size_t i = 0; i < 4; ++i) state[i] = state_[i];
  }
  bool completed() const noexcept override { return distance() < 0.1; }
  bool collided() const noexcept override {
    return std::abs(state_[0]) > 2.0 || std::abs(state_[1]) > 2.0;
  }
  void Halt() noexcept override {}

  double distance() const noexcept {
    return std::hypot(state_[0] - state_[2], state_[1] - state_[3]);
  }

 private:
  core::StateLayout layout_;
  double state_[4] = {};
};

/// The reward is the decrease of the distance to the goal.
class PointReach final : public imitation::Environment {
 public:
  const core::Plant& plant() const noexcept override { return plant_; }
  void Reset(std::uint64_t seed) override { plant_.Reset(seed); }
  StepResult Step(std::span<const double> control) override {
    const double before = plant_.distance();
    static_cast<void>(plant_.Apply(control));
    return {broken_reward ? std::nan("") : reward_scale * (before - plant_.distance() - 0.01),
            plant_.completed() || plant_.collided()};
  }

  bool broken_reward = false;
  double reward_scale = 1.0;

 private:
  PointPlant plant_;
};

}  // namespace dfr::test
