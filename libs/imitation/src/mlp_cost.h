#pragma once

#include <string>

#include "dfr/core/matrix.h"
#include "dfr/imitation/mlp.h"

namespace dfr::imitation::internal {

struct MinimizeSummary {
  int iterations = 0;
  bool converged = false;
  std::string message;
};

/// Moves the parameters of `mlp` to a minimum of RegressionLoss over all rows, by Ceres's L-BFGS.
MinimizeSummary MinimizeByLbfgs(const core::Matrix& inputs, const core::Matrix& targets,
                                double weight_decay, int max_iterations, Mlp& mlp);

/// The same by Ceres's Levenberg-Marquardt on the whole dense Jacobian: few, expensive iterations.
MinimizeSummary MinimizeByLevenbergMarquardt(const core::Matrix& inputs,
                                             const core::Matrix& targets, double weight_decay,
                                             int max_iterations, Mlp& mlp);

/// Bytes of that Jacobian.
[[nodiscard]] double JacobianBytes(const core::Matrix& targets, const Mlp& mlp);

}  // namespace dfr::imitation::internal
