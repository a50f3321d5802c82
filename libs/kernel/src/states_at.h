#pragma once

#include <span>

#include "dfr/core/matrix.h"

namespace dfr::kernel::internal {

/// Whether no entry is NaN or infinite.
[[nodiscard]] bool AllFinite(const core::Matrix& states);

/// @throws std::invalid_argument naming the demonstration that is empty, of another width than the
///   first, or not finite.
void CheckDemonstrations(std::span<const core::Matrix> demonstrations);

/// States of the longest demonstration.
[[nodiscard]] int LongestLength(std::span<const core::Matrix> demonstrations);

/// The state of every demonstration at time step t; those that have ended hold their last one.
[[nodiscard]] core::Matrix StatesAt(std::span<const core::Matrix> demonstrations, int t);

}  // namespace dfr::kernel::internal
