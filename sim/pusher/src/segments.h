#pragma once

#include <array>

namespace dfr::sim::internal {

using Point = std::array<double, 3>;

struct Segment {
  Point a{};
  Point b{};
};

/// Returns the squared distance between two segments. Also exact for parallel and zero-length
/// segments.
[[nodiscard]] double SquaredDistance(const Segment& p, const Segment& q) noexcept;

}  // namespace dfr::sim::internal
