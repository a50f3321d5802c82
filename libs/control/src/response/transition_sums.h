#pragma once

#include <cstddef>
#include <cstdint>

// Sums over the transitions of a TransitionStore, with the widest available vectors. Entries are
// summed in order of the rows, so processors with fused multiplication agree to the bit. Sums are
// floats, as transitions are: sums of some hundred rows lose a digit, which is less than the noise
// of demonstrations. Nothing allocates or throws.
namespace dfr::control::internal {

/// Widths of rows, n_left and n_right are multiples of this.
inline constexpr std::size_t kWidth = 8;
/// Number of readable entries behind points, distances and weights; those behind the latter two are
/// also written.
inline constexpr std::size_t kPadding = 16;

/// Sets distances[i] = |z_i - z|^2 for points of `dim` entries. Entry k of point i is at points[k *
/// column_stride + i].
void SquaredDistances(const float* points, std::size_t column_stride, std::size_t dim,
                      const float* z, std::size_t rows, float* distances) noexcept;

/// Sets weights[i] = exp(-scale (distances[i] - least)).
void Weights(const float* distances, std::size_t rows, float least, double scale,
             double* weights) noexcept;

/// Writes the indices of the `count` smallest distances, 1 <= count <= rows; the first ones among
/// equal distances. The order depends only on the distances. No distance may be NaN or negative.
/// `indices` has count + 1 entries.
void Nearest(const float* distances, std::size_t rows, std::size_t count,
             std::int32_t* indices) noexcept;

/// Sets right_i[k] = row_j[k] - z[k] with j = indices[i]. All have `width` entries.
void Differences(const float* rows, std::size_t width, const std::int32_t* indices,
                 std::size_t count, const float* z, float* right) noexcept;

/// Sets left_i[k] = factor weights[indices[i]] row_i[k] for n_left entries of each row. A stride is
/// the distance between the beginnings of two rows.
void ScaleRows(const float* rows, std::size_t row_stride, const std::int32_t* indices,
               std::size_t count, const double* weights, double factor, std::size_t n_left,
               float* left, std::size_t left_stride) noexcept;

/// Sets sums = left' right (n_left x n_right) for `left` (rows x n_left) and `right` (rows x
/// n_right). All are blocks of row-major matrices.
void TransposedProduct(const float* left, std::size_t left_stride, std::size_t n_left,
                       const float* right, std::size_t right_stride, std::size_t n_right,
                       std::size_t rows, float* sums, std::size_t sums_stride) noexcept;

}  // namespace dfr::control::internal
