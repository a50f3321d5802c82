#pragma once

#include <memory>
#include <vector>

#include "dfr/safety/guard_model.h"
#include "tests/safety/corridor.h"

namespace dfr::test {

/// Returns the model with this strategy.
inline std::shared_ptr<const safety::GuardModel> As(
    safety::Strategy strategy, const std::shared_ptr<const safety::GuardModel>& model) {
  safety::GuardSettings settings = model->settings();
  settings.strategy = strategy;
  return model->With(settings);
}

/// Returns a guard of the corridor with this strategy, fitted once.
inline std::shared_ptr<const safety::GuardModel> Model(
    safety::Strategy strategy = safety::Strategy::kGuard) {
  static const std::shared_ptr<const safety::GuardModel> kModel =
      safety::GuardModel::Fit(CorridorLayout(), CorridorDemonstrations(1, 30), {.features = "tip"});
  return As(strategy, kModel);
}

/// Returns the action that moves the tip by (dx, dy).
inline std::vector<double> Action(double dx, double dy) {
  const Eigen::Vector2d u = ActionFor(dx, dy);
  return {u[0], u[1]};
}

}  // namespace dfr::test
