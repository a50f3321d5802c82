#pragma once

#include <span>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "workers.h"

namespace dfr::kernel::internal {

/// The KKT gap of `alpha`, which a solver with kernel values in T believes to have this gradient.
///
/// Bounds on what rounding has done to G leave few samples that may be the extreme ones; theirs is
/// summed again in double. Where the bounds alone prove that the gap is below the tolerance, it is
/// returned as they give it, which is an upper bound.
/// @param center what the solver's terms are centred at
/// @param neglected what sums may lack, in units of G
template <typename T>
[[nodiscard]] double TrueGap(const core::Matrix& samples, const OneClassSvmOptions& options,
                             std::span<const double> center, std::span<const double> alpha,
                             std::span<const double> gradient, double neglected, Workers& workers);

}  // namespace dfr::kernel::internal
