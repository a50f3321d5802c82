#pragma once

#include <span>
#include <utility>

#include "dfr/core/plant.h"
#include "dfr/core/trajectory.h"

namespace dfr::core {

/// Records an episode from the plant's current state, of at most `horizon` controls. The episode
/// ends early if the plant is completed or has collided, or if `act` does not return
/// PlantStatus::kOk. The seed of the trajectory stays 0.
/// @param act  PlantStatus(int t, std::span<const double> x, std::span<double> u): writes the
///   recorded control of state x to u, and returns the result of Apply().
template <typename Act>
Trajectory Record(Plant& plant, int horizon, const Act& act) {
  Trajectory trajectory;
  trajectory.states.resize(horizon + 1, plant.state_dim());
  trajectory.controls.resize(horizon, plant.control_dim());
  plant.Observe(Row(trajectory.states, 0));
  int t = 0;
  for (; t < horizon && !plant.completed() && !plant.collided(); ++t) {
    const std::span<const double> x = Row(std::as_const(trajectory.states), t);
    if (act(t, x, Row(trajectory.controls, t)) != PlantStatus::kOk) break;
    plant.Observe(Row(trajectory.states, t + 1));
  }
  trajectory.outcome = plant.collided()    ? Outcome::kCollided
                       : plant.completed() ? Outcome::kCompleted
                                           : Outcome::kHalted;
  trajectory.states.conservativeResize(t + 1, Eigen::NoChange);
  trajectory.controls.conservativeResize(t, Eigen::NoChange);
  return trajectory;
}

}  // namespace dfr::core
