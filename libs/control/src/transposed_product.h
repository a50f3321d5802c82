#pragma once

#include <cstddef>

namespace dfr::control::internal {

/// Width that n_left and n_right have to be multiples of.
inline constexpr std::size_t kWidth = 8;

/// sums = left' right (n_left x n_right), for `left` (rows x n_left) and `right` (rows x n_right).
/// All are blocks of row-major matrices; a stride is how far apart two of its rows begin. Every
/// entry is summed in doubles and in order of the rows, so that processors agree to rounding. On
/// the widest vectors there are; neither allocates nor throws.
void TransposedProduct(const double* left, std::size_t left_stride, std::size_t n_left,
                       const float* right, std::size_t right_stride, std::size_t n_right,
                       std::size_t rows, double* sums, std::size_t sums_stride) noexcept;

}  // namespace dfr::control::internal
