#pragma once

#include <cstddef>

namespace dfr::control::internal {

/// Widths that n_left and n_right have to be multiples of.
inline constexpr std::size_t kLeftWidth = 8;
inline constexpr std::size_t kRightWidth = 16;

/// sums = left' right (n_left x n_right), for `left` (rows x n_left) and `right` (rows x n_right),
/// all row-major. Products of floats are exact in doubles, and every entry is summed in order of
/// the rows, so that processors agree to rounding. On the widest vectors there are; neither
/// allocates nor throws.
void TransposedProduct(const float* left, std::size_t n_left, const float* right,
                       std::size_t n_right, std::size_t rows, double* sums) noexcept;

}  // namespace dfr::control::internal
