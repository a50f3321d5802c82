#pragma once

#include <cstddef>
#include <cstdint>

namespace dfr::kernel::internal {

/// Rows of a kernel matrix, computed on demand: `known[i]` is row i, or null if not computed.
template <typename T>
struct RowTable {
  const T** known = nullptr;
  unsigned char* used = nullptr;  ///< Set to 1 when a row is used.
  /// Computes the unknown row i without overwriting row `keep`.
  const T* (*compute)(void* store, std::size_t i, std::size_t keep) = nullptr;
  void* store = nullptr;
};

/// State of a problem during its solution. Arrays of T are aligned to 64 bytes and padded to whole
/// cache lines, as rows are; `count` includes the padding.
template <typename T>
struct SmoProblem {
  /// Added to a sample's gradient to exclude it from a choice. Finite, because a number in the low
  /// bits of infinity (Numbered) would make it a NaN.
  static constexpr T kNever = sizeof(T) == 4 ? T(1e30) : T(1e300);

  std::size_t count = 0;
  RowTable<T> rows;
  double* alpha = nullptr;  ///< Without padding.
  T* gradient = nullptr;    ///< Relative to a constant common to all samples.
  T* may_rise = nullptr;    ///< 0 if alpha < 1; otherwise, and in the padding, kNever.
  T* may_fall = nullptr;    ///< 0 if alpha > 0; otherwise, and in the padding, -kNever.
  /// Memory for 1 / (1 - K) of all rows, which the loop fills in, or null.
  T* inverse = nullptr;
  unsigned char* inverse_known = nullptr;  ///< Per row: 1 if computed; initially 0.
};

/// Number of neighbouring samples whose kernel values a sparse row keeps or drops together. They
/// fill whole cache lines, both in float and in double.
inline constexpr std::size_t kSparseGroup = 64;

/// Row of a kernel matrix without the groups whose values are all negligible.
template <typename T>
struct SparseRow {
  const std::uint32_t* groups = nullptr;  ///< Ascending; null: not computed.
  const T* values = nullptr;              ///< kSparseGroup values per group, aligned to 64 bytes.
  std::size_t count = 0;                  ///< Number of groups.
};

/// SmoProblem with sparse rows. Sample i belongs to group i / kSparseGroup. Arrays of T are padded
/// to whole groups, except `smallest` and `largest`.
template <typename T>
struct SparseSmoProblem {
  static constexpr T kNever = SmoProblem<T>::kNever;

  std::size_t groups = 0;
  const SparseRow<T>* known = nullptr;
  /// Computes the unknown row i without overwriting row `keep`.
  void (*compute)(void* store, std::size_t i, std::size_t keep) = nullptr;
  void* store = nullptr;
  double* alpha = nullptr;
  T* gradient = nullptr;
  T* may_rise = nullptr;
  T* may_fall = nullptr;
  /// Per group: smallest G over alpha < 1 and largest G over alpha > 0. Padded to whole cache lines
  /// with kNever and -kNever. The loop fills them in.
  T* smallest = nullptr;
  T* largest = nullptr;
};

/// Extremes of G over samples that may still move; infinite if there are none. They ignore NaN.
struct Extremes {
  double largest = 0.0;   ///< over alpha > 0
  double smallest = 0.0;  ///< over alpha < 1
  double finite = 0.0;    ///< Zero; NaN if a G is not finite.
};
[[nodiscard]] Extremes FindExtremes(const double* alpha, const double* gradient,
                                    std::size_t count) noexcept;

struct SmoSteps {
  std::int64_t taken = 0;
  bool more = false;  ///< True if the loop stopped after `most` steps, before it was done.
};

template <typename T>
struct SmoFunctions {
  /// Sequential minimal optimisation with second-order working-set selection (Fan, Chen and Lin,
  /// "Working set selection using second order information", JMLR 6, 2005). Ends when the KKT gap
  /// is below `target`, no step decreases the objective, or `most` steps were taken.
  SmoSteps (*loop)(const SmoProblem<T>& problem, double target, std::int64_t most) = nullptr;
  /// totals = sum_q weights[q] rows[q], in double; `size` entries per row, whole cache lines.
  void (*combine)(const T* const* rows, const double* weights, std::size_t rows_count,
                  std::size_t size, double* totals) = nullptr;
  /// loop() for sparse rows.
  SmoSteps (*sparse_loop)(const SparseSmoProblem<T>& problem, double target,
                          std::int64_t most) = nullptr;
  /// totals += weight * row for the groups [first, last); `totals` starts with group 0.
  void (*add_sparse)(const SparseRow<T>& row, double weight, std::size_t first, std::size_t last,
                     double* totals) = nullptr;
};

/// Functions for the instruction set of ForceTarget(), by default the widest of this machine.
template <typename T>
[[nodiscard]] SmoFunctions<T> BestSmoFunctions();

}  // namespace dfr::kernel::internal
