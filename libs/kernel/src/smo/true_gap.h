#pragma once

#include <span>

#include "dfr/core/matrix.h"
#include "dfr/core/workers.h"
#include "dfr/kernel/one_class_svm.h"
#include "gaussian/gaussian_terms.h"

namespace dfr::kernel::internal {

/// Returns the KKT gap of `alpha`. A solver computed `gradient` with kernel values in T.
///
/// Bounds on the rounding errors of G leave few samples that may have the largest or smallest G.
/// Only their G is summed again in double. If the bounds alone prove that the gap is below the
/// tolerance, returns the upper bound that they give.
/// @param extent  of `samples`
/// @param center  centre of the solver's terms
/// @param neglected  bound on the sum of the kernel values that each entry of `gradient` leaves out
template <typename T>
[[nodiscard]] double TrueGap(const core::Matrix& samples, const Extent& extent,
                             const OneClassSvmOptions& options, std::span<const double> center,
                             std::span<const double> alpha, std::span<const double> gradient,
                             double neglected, core::Workers& workers);

}  // namespace dfr::kernel::internal
