#pragma once

#include <span>

#include "dfr/core/features/features.h"
#include "dfr/core/trajectory.h"

namespace dfr::safety::internal {

/// @throws std::invalid_argument naming the defect unless a guard can be fitted to states of this
///   layout: at least three demonstrations, of one shape, with finite and measurable entries.
void CheckDemonstrations(const core::StateLayout& layout,
                         std::span<const core::Trajectory> demonstrations);

}  // namespace dfr::safety::internal
