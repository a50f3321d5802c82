#pragma once

#include <cstddef>
#include <span>
#include <vector>

namespace dfr::kernel::internal {

/// From this nu on, any solution needs most rows of the kernel matrix.
inline constexpr double kLargeNu = 0.25;

// Initial values for solvers: alpha in [0, 1] that sums to `total` (LIBSVM's scale).

/// Sets the first samples of `order` to the bound until alpha of all `count` samples sums to
/// `total`.
[[nodiscard]] std::vector<double> Fill(std::span<const std::size_t> order, std::size_t count,
                                       double total);

/// Sets as many samples as `total` requires to the bound, at equal intervals.
[[nodiscard]] std::vector<double> EvenlySpread(std::size_t count, double total);

/// Scales `start` to sum to `total`, clips it at the bound and distributes the rest.
[[nodiscard]] std::vector<double> Feasible(std::span<const double> start, double total);

}  // namespace dfr::kernel::internal
