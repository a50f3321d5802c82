#pragma once

#include <span>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/trajectory.h"

namespace dfr::control {

/// How EstimateLambda() came to its result.
struct LambdaSummary {
  /// Transitions with u_t != 0 at each time step.
  std::vector<int> transitions;
  /// Time steps that took over the value of a neighbour, as their own data said nothing.
  int filled_steps = 0;
};

/// The change of the decision function per unit of control, one value per time step:
///   lambda_t = max over demonstrated transitions of |g_t(x_{t+1}) - g_t(x_t)| / |u_t|.
///
/// Transitions with u_t = 0 (padding) are left out. A time step without any other, or whose g never
/// changed, takes the value of the nearest earlier step that has one, else of the nearest later:
/// lambda = 0 would open the gate everywhere. This is a maximum over a sample, not a bound: fewer
/// demonstrations give a smaller lambda and so a less careful policy.
///
/// @returns as many entries as the longest demonstration has steps.
/// @throws std::invalid_argument if a demonstration's shape does not fit the support or itself, has
///   a non-finite entry, or if no transition at all changes g; the message names which.
[[nodiscard]] std::vector<double> EstimateLambda(const core::DecisionFunction& support,
                                                 std::span<const core::Trajectory> demonstrations,
                                                 LambdaSummary* summary = nullptr);

}  // namespace dfr::control
