#pragma once

#include <algorithm>
#include <cstddef>
#include <ranges>

namespace dfr::core {

/// The value with `rank` others before it in ascending order. Rearranges `values`; allocates
/// nothing. @pre 0 <= rank < number of values, none of which is NaN
template <std::ranges::random_access_range Values>
[[nodiscard]] auto ValueOfRank(Values&& values, std::ptrdiff_t rank) noexcept {
  const auto nth = std::ranges::begin(values) + rank;
  std::nth_element(std::ranges::begin(values), nth, std::ranges::end(values));
  return *nth;
}

/// The median; for an even number of values the upper one of the two in the middle, so that the
/// result is one of them. Otherwise as ValueOfRank(). @pre there is a value
template <std::ranges::random_access_range Values>
[[nodiscard]] auto Median(Values&& values) noexcept {
  return ValueOfRank(values, std::ranges::ssize(values) / 2);
}

/// The q-quantile without interpolation: the value of rank floor(q (n - 1)). Otherwise as
/// ValueOfRank(). @pre there is a value, 0 <= q <= 1
template <std::ranges::random_access_range Values>
[[nodiscard]] auto Quantile(Values&& values, double q) noexcept {
  const auto last = static_cast<double>(std::ranges::ssize(values) - 1);
  return ValueOfRank(values, static_cast<std::ptrdiff_t>(q * last));
}

}  // namespace dfr::core
