#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"

namespace dfr::kernel::internal {

/// Whether no entry is NaN or infinite.
[[nodiscard]] bool AllFinite(const Eigen::Ref<const core::Matrix>& states);

/// Demonstrations as the functions below take them, wherever their memory is.
using StatesView = Eigen::Map<const core::Matrix>;
[[nodiscard]] std::vector<StatesView> Views(std::span<const core::Matrix> demonstrations);

/// @throws std::invalid_argument naming the demonstration that is empty, of another width than the
///   first, or not finite.
void CheckDemonstrations(std::span<const StatesView> demonstrations);

/// States of the longest demonstration.
[[nodiscard]] int LongestLength(std::span<const StatesView> demonstrations);

/// The state of every demonstration at time step t; those that have ended hold their last one.
[[nodiscard]] core::Matrix StatesAt(std::span<const StatesView> demonstrations, int t);

}  // namespace dfr::kernel::internal
