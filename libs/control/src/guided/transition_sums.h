#pragma once

#include <cstddef>
#include <cstdint>

// What a TransitionStore does with its transitions, on the widest vectors there are. Every entry is
// summed in order of the rows, so that processors with fused multiplication agree to the bit. Sums
// are floats, as transitions are: those of some hundred rows lose a digit, and the noise of
// demonstrations is larger. Nothing allocates or throws.
namespace dfr::control::internal {

/// A multiple of this are the widths of rows, n_left and n_right.
inline constexpr std::size_t kWidth = 8;
/// So many entries behind points, distances and weights may be read, and those of the latter two
/// written.
inline constexpr std::size_t kPadding = 16;

/// distances[i] = |z_i - z|^2, for points of `dim` entries, of which entry k of point i is at
/// points[k * column_stride + i].
void SquaredDistances(const float* points, std::size_t column_stride, std::size_t dim,
                      const float* z, std::size_t rows, float* distances) noexcept;

/// weights[i] = exp(-scale (distances[i] - least)).
void Weights(const float* distances, std::size_t rows, float least, double scale,
             double* weights) noexcept;

/// The indices of the `count` smallest distances, 1 <= count <= rows, of equal ones the first, in
/// an order that the distances decide. None is NaN or negative. `indices` has count + 1 entries.
void Nearest(const float* distances, std::size_t rows, std::size_t count,
             std::int32_t* indices) noexcept;

/// right_i[k] = row_j[k] - z[k], where j = indices[i]. All have `width` entries.
void Differences(const float* rows, std::size_t width, const std::int32_t* indices,
                 std::size_t count, const float* z, float* right) noexcept;

/// left_i[k] = factor weights[indices[i]] row_i[k], n_left entries of each row. A stride is how far
/// apart two rows begin.
void ScaleRows(const float* rows, std::size_t row_stride, const std::int32_t* indices,
               std::size_t count, const double* weights, double factor, std::size_t n_left,
               float* left, std::size_t left_stride) noexcept;

/// sums = left' right (n_left x n_right), for `left` (rows x n_left) and `right` (rows x n_right).
/// All are blocks of row-major matrices.
void TransposedProduct(const float* left, std::size_t left_stride, std::size_t n_left,
                       const float* right, std::size_t right_stride, std::size_t n_right,
                       std::size_t rows, float* sums, std::size_t sums_stride) noexcept;

}  // namespace dfr::control::internal
