#pragma once

#include "dfr/kernel/one_class_svm.h"
#include "gaussian/gaussian_terms.h"

namespace dfr::kernel::internal {

/// @throws std::invalid_argument naming the option that is out of range, or describing the invalid
/// shape of samples, start or weights, or the invalid value of a start or weight.
void CheckShapes(const core::Matrix& samples, const OneClassSvmOptions& options);

/// @throws std::invalid_argument naming the sample that is not finite, or whose distance to the
/// others in kernel widths overflows when squared: the fit would treat it incorrectly.
void CheckSamples(const core::Matrix& samples, const Extent& extent, double gamma);

}  // namespace dfr::kernel::internal
