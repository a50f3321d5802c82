#pragma once

#include "dfr/kernel/one_class_svm.h"
#include "small_problem.h"

namespace dfr::kernel::internal {

/// OneClassSvm::Fit(). Its bits depend on whether `scratch` has distances (they must be those of
/// the samples), not on what was fitted with it before.
OneClassSvm FitSharing(const core::Matrix& samples, const OneClassSvmOptions& options,
                       Scratch& scratch, FitSummary* summary);

}  // namespace dfr::kernel::internal
