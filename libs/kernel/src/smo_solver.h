#pragma once

#include <Eigen/Core>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel::internal {

/// The dual of the one-class SVM in LIBSVM's scale: min alpha' K alpha / 2 subject to
/// sum(alpha) = nu m, 0 <= alpha <= 1.
struct DualSolution {
  Eigen::VectorXd alpha;  ///< m entries.
  double rho = 0.0;
};

/// Sequential minimal optimisation with second-order working-set selection (Fan, Chen and Lin,
/// "Working set selection using second order information", JMLR 6, 2005).
/// @pre options and samples have been checked.
[[nodiscard]] DualSolution SolveDual(const core::Matrix& samples, const OneClassSvmOptions& options,
                                     FitSummary& summary);

}  // namespace dfr::kernel::internal
