#pragma once

#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel {

/// Returns a radius c for which the balls of radius c around the support vectors cover {x : l(x) >=
/// -level}. Every state farther than c from all samples is outside this set.
///
/// Because the weights sum to 1, c = sqrt((level - log rho) / gamma) is valid. The distances
/// between support vectors reduce c: a state at distance d from its nearest support vector i is at
/// least max(d, |x_i - x_j| - d) from each x_j, and the weighted sum of kernels at these distances
/// must reach rho exp(-level). O(m^2) for m support vectors.
/// @returns 0 if the set is empty, infinity if it contains every state (rho <= 0).
/// @throws std::invalid_argument if level is not finite.
[[nodiscard]] double CoverRadius(const OneClassSvm& svm, double level);

}  // namespace dfr::kernel
