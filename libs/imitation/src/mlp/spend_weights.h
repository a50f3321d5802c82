#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>

#include "dfr/core/files/archive.h"
#include "dfr/imitation/mlp.h"

namespace dfr::imitation::internal {

/// Calls archive.Spend() for the weights between successive layers of these sizes. Call before
/// creating a network: a few sizes can request any number of weights.
inline void SpendWeights(std::span<const int> sizes, core::ArchiveReader& archive) {
  for (std::size_t i = 1; i < sizes.size(); ++i) {
    const auto inputs = static_cast<std::uint64_t>(std::clamp(sizes[i - 1], 0, Mlp::kMaxWidth));
    const auto outputs = static_cast<std::uint64_t>(std::clamp(sizes[i], 0, Mlp::kMaxWidth));
    archive.Spend((inputs + 1) * outputs, sizeof(double), "weights");
  }
}

}  // namespace dfr::imitation::internal
