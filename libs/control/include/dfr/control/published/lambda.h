#pragma once

#include <span>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/trajectory.h"

namespace dfr::control {

/// Estimates the change of the decision function per unit of control, one value per time step:
///   lambda_t = max over demonstrated transitions of |g_t(x_{t+1}) - g_t(x_t)| / |u_t|.
///
/// Transitions with u_t = 0 (padding) are ignored. A time step without a positive value takes the
/// value of the nearest earlier step that has one, otherwise of the nearest later one, because
/// lambda = 0 would open the gate everywhere. This is a maximum over a sample, not a bound: with
/// fewer demonstrations lambda is smaller, and the gate passes more controls.
///
/// @returns one entry per step of the longest demonstration.
/// @throws std::invalid_argument naming the demonstration whose shapes do not match the support or
/// each other, or which has a non-finite entry, or if no transition changes g.
[[nodiscard]] std::vector<double> EstimateLambda(const core::DecisionFunction& support,
                                                 std::span<const core::Trajectory> demonstrations);

}  // namespace dfr::control
