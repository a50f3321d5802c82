#pragma once

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "smo/smo_solver.h"

namespace dfr::kernel::internal {

/// The dual with an individual bound for each sample: min alpha' K alpha / 2 subject to sum(alpha)
/// = nu sum(w), 0 <= alpha_i <= w_i. Sequential minimal optimisation as in SolveDual(), on all
/// samples at once and in double throughout. Computes rows of K on demand.
/// @pre options and samples have been checked; options.weights has one entry per sample.
[[nodiscard]] DualSolution SolveWeightedDual(const core::Matrix& samples,
                                             const OneClassSvmOptions& options,
                                             FitSummary& summary);

}  // namespace dfr::kernel::internal
