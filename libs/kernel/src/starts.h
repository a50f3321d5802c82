#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace dfr::kernel::internal {

/// Where solvers begin: alpha in [0, 1] that sums to `total` (LIBSVM's scale).

/// The first samples of `order` at the bound, until alpha, of all `count` samples, sums to `total`.
[[nodiscard]] std::vector<double> Fill(std::span<const std::size_t> order, std::size_t count,
                                       double total);

/// As many samples as hold `total` at the bound, at equal intervals.
[[nodiscard]] std::vector<double> EvenlySpread(std::size_t count, double total);

/// The given start, in any scale: scaled, cut at the bound and filled up to `total`.
[[nodiscard]] std::vector<double> Feasible(std::span<const double> start, double total);

}  // namespace dfr::kernel::internal
