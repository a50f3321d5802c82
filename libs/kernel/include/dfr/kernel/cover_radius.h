#pragma once

#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel {

/// A radius c such that {x : l(x) >= -level} lies in the union of the balls of radius c around the
/// support vectors: no state that deep inside is further from all samples. Whatever keeps a
/// distance of c from every sample is outside.
///
/// As the weights sum to 1, c = sqrt((level - log rho) / gamma) is one. It is taken as small as
/// distances between support vectors allow: a state whose nearest one, i, is d away is at least
/// max(d, |x_i - x_j| - d) from j, and the sum of kernels at these distances must reach
/// rho exp(-level). O(m^2) for m support vectors.
/// @returns 0 if no state is that deep inside. @throws std::invalid_argument if level is not
/// finite.
[[nodiscard]] double CoverRadius(const OneClassSvm& svm, double level);

}  // namespace dfr::kernel
