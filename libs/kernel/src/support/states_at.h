#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"

namespace dfr::kernel::internal {

/// View of a demonstration's states in memory owned elsewhere.
using StatesView = Eigen::Map<const core::Matrix>;
[[nodiscard]] std::vector<StatesView> Views(std::span<const core::Matrix> demonstrations);

/// @throws std::invalid_argument naming the demonstration that is empty, of a width other than the
///   first, or not finite.
void CheckDemonstrations(std::span<const StatesView> demonstrations);

/// Number of states of the longest demonstration.
[[nodiscard]] int LongestLength(std::span<const StatesView> demonstrations);

/// Returns the state of every demonstration at time step t. Demonstrations that have ended hold
/// their last state.
[[nodiscard]] core::Matrix StatesAt(std::span<const StatesView> demonstrations, int t);

}  // namespace dfr::kernel::internal
