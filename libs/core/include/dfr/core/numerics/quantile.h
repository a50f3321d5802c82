#pragma once

#include <algorithm>
#include <cstddef>
#include <ranges>

namespace dfr::core {

/// Returns the value with rank `rank` in ascending order; the smallest has rank 0. Rearranges
/// `values`; allocates nothing. @pre 0 <= rank < number of values, none of which is NaN
template <std::ranges::random_access_range Values>
[[nodiscard]] auto ValueOfRank(Values&& values, std::ptrdiff_t rank) noexcept {
  const auto nth = std::ranges::begin(values) + rank;
  std::nth_element(std::ranges::begin(values), nth, std::ranges::end(values));
  return *nth;
}

/// Returns the median. For an even number of values, it is the upper of the two middle ones: the
/// result is always one of the values. Rearranges `values`. @pre values are not empty
template <std::ranges::random_access_range Values>
[[nodiscard]] auto Median(Values&& values) noexcept {
  return ValueOfRank(values, std::ranges::ssize(values) / 2);
}

/// Returns the q-quantile without interpolation: the value of rank floor(q (n - 1)). Rearranges
/// `values`. @pre values are not empty, 0 <= q <= 1
template <std::ranges::random_access_range Values>
[[nodiscard]] auto Quantile(Values&& values, double q) noexcept {
  const auto last = static_cast<double>(std::ranges::ssize(values) - 1);
  return ValueOfRank(values, static_cast<std::ptrdiff_t>(q * last));
}

}  // namespace dfr::core
