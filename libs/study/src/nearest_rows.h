#pragma once

#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <utility>

#include "dfr/core/matrix.h"

namespace dfr::study::internal {

/// Returns the squared distances to `z` and the indices of the `kCount` nearest rows in [first,
/// last) for which counts(row) is true, in ascending order; index -1 if there are fewer.
template <std::size_t kCount, typename Counts>
std::array<std::pair<double, Eigen::Index>, kCount> NearestRows(const core::Matrix& points,
                                                                Eigen::Index first,
                                                                Eigen::Index last,
                                                                std::span<const double> z,
                                                                const Counts& counts) noexcept {
  std::array<std::pair<double, Eigen::Index>, kCount> nearest;
  nearest.fill({std::numeric_limits<double>::infinity(), -1});
  for (Eigen::Index row = first; row < last; ++row) {
    if (!counts(row)) continue;
    const double distance = (points.row(row).transpose() - core::AsVector(z)).squaredNorm();
    if (!(distance < nearest.back().first)) continue;
    nearest.back() = {distance, row};
    for (std::size_t i = kCount - 1; i > 0 && nearest[i] < nearest[i - 1]; --i) {
      std::swap(nearest[i], nearest[i - 1]);
    }
  }
  return nearest;
}

}  // namespace dfr::study::internal
