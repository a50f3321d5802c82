#pragma once

#include <Eigen/Core>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "problems/small_problem.h"

namespace dfr::kernel::internal {

/// Dual of the one-class SVM in LIBSVM's scale: min alpha' K alpha / 2 subject to sum(alpha) = nu
/// m, 0 <= alpha <= 1.
struct DualSolution {
  Eigen::VectorXd alpha;  ///< m entries.
  /// A sample with G = rho, up to the tolerance. A few of them show how far kernel values in float,
  /// whose errors all have the same sign, have shifted rho.
  struct RhoSample {
    Eigen::Index sample;
    double gradient;
  };
  double rho = 0.0;
  std::vector<RhoSample> rho_samples;
};

/// Solves the dual by sequential minimal optimisation.
/// @param extent  of `samples`
/// @pre options and samples have been checked.
[[nodiscard]] DualSolution SolveDual(const core::Matrix& samples, const Extent& extent,
                                     const OneClassSvmOptions& options, Scratch& scratch,
                                     FitSummary& summary);

}  // namespace dfr::kernel::internal
