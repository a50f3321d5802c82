#include "dfr/control/published/lambda.h"

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "dfr/core/contract.h"

namespace dfr::control {

std::vector<double> EstimateLambda(const core::DecisionFunction& support,
                                   std::span<const core::Trajectory> demonstrations) {
  std::vector<double> lambda;
  for (std::size_t i = 0; i < demonstrations.size(); ++i) {
    const core::Matrix& states = demonstrations[i].states;
    const core::Matrix& controls = demonstrations[i].controls;
    DFR_THROW_UNLESS(states.cols() == support.state_dim(),
                     "demonstration " << i << ": its states have " << states.cols()
                                      << " entries, but the support takes " << support.state_dim());
    DFR_THROW_UNLESS(states.rows() == controls.rows() + 1,
                     "demonstration " << i << ": " << controls.rows() << " controls and "
                                      << states.rows()
                                      << " states; one state more than controls is needed");
    DFR_THROW_UNLESS(states.allFinite() && controls.allFinite(),
                     "demonstration " << i << " has a non-finite entry");
    const auto steps = static_cast<std::size_t>(controls.rows());
    if (lambda.size() < steps) lambda.resize(steps, 0.0);
    for (std::size_t t = 0; t < steps; ++t) {
      const auto row = static_cast<Eigen::Index>(t);
      const double size = controls.row(row).norm();
      if (size == 0.0) continue;
      const int time = static_cast<int>(t);
      const double change = std::abs(support.Decision(time, core::Row(states, row + 1)) -
                                     support.Decision(time, core::Row(states, row)));
      DFR_THROW_UNLESS(std::isfinite(change),
                       "demonstration " << i << ": g is not finite at step " << t);
      lambda[t] = std::max(lambda[t], change / size);
    }
  }
  const auto known = [](double value) { return value > 0.0; };
  const auto first = std::find_if(lambda.begin(), lambda.end(), known);
  DFR_THROW_UNLESS(
      first != lambda.end(),
      "lambda cannot be estimated: in "
          << demonstrations.size()
          << " demonstrations no nonzero control changes g. The kernel is too narrow "
             "or too wide: choose a smaller gamma, or a larger one if it is far below 1");
  std::fill(lambda.begin(), first, *first);
  for (auto it = first + 1; it != lambda.end(); ++it) {
    if (!known(*it)) *it = *(it - 1);
  }
  return lambda;
}

}  // namespace dfr::control
