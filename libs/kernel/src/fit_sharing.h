#pragma once

#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/time_varying_support.h"
#include "small_problem.h"
#include "states_at.h"

namespace dfr::kernel::internal {

/// OneClassSvm::Fit(). Its bits depend on whether `scratch` has distances (they must be those of
/// the samples), not on what was fitted with it before.
OneClassSvm FitSharing(const core::Matrix& samples, const OneClassSvmOptions& options,
                       Scratch& scratch, FitSummary* summary);

struct NuGamma {
  double nu;
  double gamma;
};

/// TimeVaryingSupport::Fit() for each pair of `grid` (their own in `options` count for nothing).
/// What is small enough computes the distances between its samples once for the whole grid.
/// `summaries`, if given, receives one entry per estimate of each pair in turn.
std::vector<TimeVaryingSupport> FitGrid(std::span<const StatesView> demonstrations,
                                        const TimeVaryingSupportOptions& options,
                                        std::span<const NuGamma> grid,
                                        std::vector<FitSummary>* summaries = nullptr);

}  // namespace dfr::kernel::internal
