#pragma once

#include <string_view>

#include "dfr/core/matrix.h"

namespace dfr::imitation::internal {

/// @throws std::invalid_argument naming the first entry of `rows` that is not finite, for example
///   "states: row 3, column 1 is nan".
void CheckFinite(const core::Matrix& rows, std::string_view name);

}  // namespace dfr::imitation::internal
