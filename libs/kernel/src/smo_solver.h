#pragma once

#include <Eigen/Core>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "small_problem.h"

namespace dfr::kernel::internal {

/// The dual of the one-class SVM in LIBSVM's scale: min alpha' K alpha / 2 subject to
/// sum(alpha) = nu m, 0 <= alpha <= 1.
struct DualSolution {
  Eigen::VectorXd alpha;  ///< m entries.
  /// Where G = rho, up to the tolerance: a few samples that show how far kernel values in float,
  /// which are all off in the same direction, have moved rho.
  struct RhoSample {
    Eigen::Index sample;
    double gradient;
  };
  double rho = 0.0;
  std::vector<RhoSample> rho_samples;
};

/// Sequential minimal optimisation.
/// @pre options and samples have been checked.
[[nodiscard]] DualSolution SolveDual(const core::Matrix& samples, const OneClassSvmOptions& options,
                                     Scratch& scratch, FitSummary& summary);

}  // namespace dfr::kernel::internal
