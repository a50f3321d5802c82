#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <new>
#include <span>
#include <utility>
#include <vector>

#include "dfr/core/matrix.h"

namespace dfr::kernel::internal {

/// Allocator for std::vector that aligns memory for SIMD. It leaves entries without a value
/// uninitialised, because rows of the kernel matrix are written before they are read.
template <typename T>
struct AlignedAllocator {
  using value_type = T;
  static constexpr std::align_val_t kAlignment{64};
  AlignedAllocator() = default;
  // Allocators of different types convert to each other.
  template <typename U>
  AlignedAllocator(const AlignedAllocator<U>&) noexcept {}  // NOLINT(google-explicit-constructor)
  T* allocate(std::size_t n) { return static_cast<T*>(::operator new(n * sizeof(T), kAlignment)); }
  void deallocate(T* p, std::size_t) noexcept { ::operator delete(p, kAlignment); }
  template <typename U>
  void construct(U* p) noexcept {
    ::new (static_cast<void*>(p)) U;
  }
  template <typename U, typename V>
  void construct(U* p, V&& value) noexcept {
    ::new (static_cast<void*>(p)) U(std::forward<V>(value));
  }
  bool operator==(const AlignedAllocator&) const = default;
};
template <typename T>
using AlignedVector = std::vector<T, AlignedAllocator<T>>;

/// Maximum number of entries of a state: queries are scaled into a buffer on the stack.
inline constexpr int kMaxStateDim = 2048;

/// Mean of each coordinate and largest absolute entry of some points, found in one pass.
struct Extent {
  explicit Extent(const core::Matrix& points);
  std::vector<double> mean;
  double largest = 0.0;  ///< Ignores NaN.
  bool finite = true;    ///< False if an entry is not finite or a sum of entries overflows.
};

/// Returns the centre for the terms of `points`: their mean, or the median of each coordinate if
/// outliers, many widths 1 / scale away, could move the mean far from most points.
[[nodiscard]] std::vector<double> Center(const core::Matrix& points, const Extent& extent,
                                         double scale);

template <typename T>
struct GaussianTerms;
template <typename T>
struct GroupBoxes;

/// Functions of gaussian_sum.h that compute rows, for one instruction set.
template <typename T>
struct GaussianFunctions {
  void (*row)(const GaussianTerms<T>&, const T* x, T* row) = nullptr;
  void (*all_rows)(const GaussianTerms<T>&, T* point, T* rows, T* sums) = nullptr;
  void (*exponents)(const GaussianTerms<T>&, const T* x, T* row) = nullptr;
  void (*powers)(const T* exponents, T factor, std::size_t size, T* row) = nullptr;
  void (*add_rows)(const GaussianTerms<T>&, std::size_t first, std::size_t last, const T* x,
                   const T* weights, std::size_t count, double* totals) = nullptr;
  std::size_t (*near_groups)(const GroupBoxes<T>&, const T* x, T reach,
                             std::uint32_t* groups) = nullptr;
  std::size_t (*near_row)(const GaussianTerms<T>&, const T* x, T reach, std::uint32_t* groups,
                          std::size_t count, T* values) = nullptr;
};

/// Computes scale (x - center) of `x` (dim entries). Returns false if an entry is not finite or so
/// far away that its square overflows; every term is then zero.
template <typename T>
[[nodiscard]] bool ScaleState(const double* x, const double* center, double scale, std::size_t dim,
                              T* scaled) noexcept {
  constexpr double kFar = sizeof(T) == sizeof(double) ? 1e150 : 1e18;
  bool near = true;
  for (std::size_t k = 0; k < dim; ++k) {
    const double v = scale * (x[k] - center[k]);
    near &= std::abs(v) < kFar;  // false for NaN
    scaled[k] = static_cast<T>(v);
  }
  return near;
}

/// Terms w_i exp(-gamma |x - s_i|^2) of a sum, in the layout of the SIMD code.
///
/// A term is 2^(log2 w_i - |x' - s'_i|^2) with x' = sqrt(gamma log2 e) (x - center): the weight,
/// the width and the change of base cost nothing per query. Terms are stored in blocks of kLanes,
/// one cache line per row: row 0 of a block holds log2 w_i, row 1 + k coordinate k. Terms of weight
/// zero (log2 w = -infinity) fill the last block, which avoids a remainder loop.
template <typename T>
struct GaussianTerms {
  static constexpr std::size_t kLanes = 64 / sizeof(T);

  GaussianTerms() = default;
  /// Creates one term per row of `points`. Empty `weights`: all are one.
  /// @pre weights are positive, one per point or none; gamma > 0
  GaussianTerms(const core::Matrix& points, std::span<const double> weights, double gamma)
      : GaussianTerms(points, Extent(points), weights, gamma) {}
  /// Overload for a known extent of `points`.
  GaussianTerms(const core::Matrix& points, const Extent& extent, std::span<const double> weights,
                double gamma);

  /// Computes x' of `x`, like ScaleState().
  [[nodiscard]] bool Scale(const double* x, T* scaled) const noexcept {
    return ScaleState(x, center.data(), scale, dim, scaled);
  }

  /// Returns the terms with these indices, in this order, padded to a multiple of `whole` terms.
  [[nodiscard]] GaussianTerms Subset(std::span<const std::size_t> indices,
                                     std::size_t whole = kLanes) const;

  /// Writes x' of the point of term i (dim entries).
  void Point(std::size_t i, T* scaled) const noexcept {
    const T* column = data.data() + i / kLanes * (dim + 1) * kLanes + i % kLanes;
    for (std::size_t k = 0; k < dim; ++k) scaled[k] = column[(1 + k) * kLanes];
  }

  /// Number of entries of a row over all terms.
  [[nodiscard]] std::size_t row_size() const noexcept { return num_blocks * kLanes; }

  GaussianFunctions<T> functions;
  std::size_t dim = 0;
  std::size_t count = 0;
  std::size_t num_blocks = 0;
  double scale = 0.0;  ///< sqrt(gamma log2 e)
  std::vector<double> center;
  AlignedVector<T> data;
};

/// Bounding boxes of groups of successive terms, scaled like the terms.
template <typename T>
struct GroupBoxes {
  static constexpr std::size_t kGroup = 64;  ///< Number of terms of a group.

  /// @pre the terms fill whole groups
  explicit GroupBoxes(const GaussianTerms<T>& terms);

  std::size_t dim = 0;
  std::size_t count = 0;
  /// Blocks of kLanes groups: per coordinate, one row of lower corners and one row of upper
  /// corners.
  AlignedVector<T> data;
};

extern template struct GroupBoxes<double>;
extern template struct GroupBoxes<float>;
extern template struct GaussianTerms<double>;
extern template struct GaussianTerms<float>;

}  // namespace dfr::kernel::internal
