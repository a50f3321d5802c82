#pragma once

#include <cstddef>
#include <cstdint>

// Sums over the transitions of a TransitionStore, with the widest available vectors. Entries are
// summed in order of the rows, so processors with fused multiply-add agree bit for bit. Sums are
// floats, like transitions. A sum of some hundred rows loses one decimal digit, which is less than
// the noise of demonstrations. Nothing allocates or throws.
namespace dfr::control::internal {

/// Row widths, n_left and n_right are multiples of kWidth.
inline constexpr std::size_t kWidth = 8;
/// Number of readable entries past the ends of points, distances, indices and weights. The entries
/// past distances and weights are also written. The entries past indices must be valid indices.
inline constexpr std::size_t kPadding = 16;
/// Number of rows that are scaled and then multiplied while they are in the cache.
inline constexpr std::size_t kTile = 32;

/// Sets distances[i] = |z_i - z|^2 for points of `dim` entries. Entry k of point i is at points[k *
/// column_stride + i].
/// @returns the least distance; NaN if the sum of the distances is not finite.
float SquaredDistances(const float* points, std::size_t column_stride, std::size_t dim,
                       const float* z, std::size_t rows, float* distances) noexcept;

/// Sets weights[i] = exp(-scale (distances[indices[i]] - least)) + floor.
/// @returns their sum.
double Weights(const float* distances, const std::int32_t* indices, std::size_t count, float least,
               double scale, double floor, double* weights) noexcept;

/// Writes the indices of the `count` smallest distances, 1 <= count <= rows; among equal distances,
/// the first ones. The order depends only on the distances. No distance may be NaN or negative.
/// `indices` has count + 1 entries.
void Nearest(const float* distances, std::size_t rows, std::size_t count,
             std::int32_t* indices) noexcept;

/// Sets sums = sum_i factor weights[i] left_i' right_i (n_left x n_right). Rows are `stride`
/// entries apart; rows of `sums` are `sums_stride` entries apart. `tile` has kTile n_left entries
/// of scratch memory.
void WeightedSums(const float* left, std::size_t n_left, const float* right, std::size_t n_right,
                  std::size_t stride, const double* weights, double factor, std::size_t count,
                  float* tile, float* sums, std::size_t sums_stride) noexcept;

/// Sets sums = sum_i factor weights[i] left_i' right_i (n_left x width). right_i is row_j - z with
/// j = indices[i], and left_i consists of the first n_left entries of right_i. Rows, z and the rows
/// of `sums` have `width` entries. `tile` has kTile (n_left + width) entries of scratch memory.
void WeightedSumsAbout(const float* z, const float* rows, std::size_t width,
                       const std::int32_t* indices, const double* weights, double factor,
                       std::size_t count, std::size_t n_left, float* tile, float* sums) noexcept;

}  // namespace dfr::control::internal
