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

/// Minimises RegressionLoss over all rows with Ceres's L-BFGS, starting from the parameters of
/// `mlp`.
MinimizeSummary MinimizeByLbfgs(const core::Matrix& inputs, const core::Matrix& targets,
                                double weight_decay, int max_iterations, Mlp& mlp);

/// Minimises RegressionLoss with Ceres's Levenberg-Marquardt on the whole dense Jacobian: few,
/// expensive iterations.
MinimizeSummary MinimizeByLevenbergMarquardt(const core::Matrix& inputs,
                                             const core::Matrix& targets, double weight_decay,
                                             int max_iterations, Mlp& mlp);

/// Returns the number of residuals of MinimizeByLevenbergMarquardt(): one per target and, with
/// weight decay, one per weight. The Jacobian has one row per residual.
[[nodiscard]] Eigen::Index NumResiduals(const core::Matrix& targets, double weight_decay,
                                        const Mlp& mlp);

}  // namespace dfr::imitation::internal
