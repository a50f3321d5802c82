#pragma once

#include <cstddef>
#include <cstdint>

namespace dfr::kernel::internal {

/// Rows of a kernel matrix, most of which have been computed: `known[i]` is row i, or null.
template <typename T>
struct RowTable {
  const T** known = nullptr;
  unsigned char* used = nullptr;  ///< Set to 1 where a row was looked at.
  /// Computes row i, which is not known, without overwriting row `keep`.
  const T* (*compute)(void* store, std::size_t i, std::size_t keep) = nullptr;
  void* store = nullptr;
};

/// A problem in the course of its solution. Arrays of T are aligned to 64 bytes and padded to whole
/// cache lines, as rows are; `count` includes the padding.
template <typename T>
struct SmoProblem {
  /// Keeps a sample out of a choice, when added to its gradient. Finite, because a NaN is never
  /// chosen.
  static constexpr T kNever = sizeof(T) == 4 ? T(1e30) : T(1e300);

  std::size_t count = 0;
  RowTable<T> rows;
  double* alpha = nullptr;  ///< Without padding.
  T* gradient = nullptr;    ///< Relative to whatever is common to all samples.
  T* may_rise = nullptr;    ///< 0 where alpha < 1, else and in the padding kNever.
  T* may_fall = nullptr;    ///< 0 where alpha > 0, else and in the padding -kNever.
};

struct SmoSteps {
  std::int64_t taken = 0;
  bool more = false;  ///< Stopped because `most` steps were taken, not because it was done.
};

template <typename T>
struct SmoFunctions {
  /// Sequential minimal optimisation with second-order working-set selection (Fan, Chen and Lin,
  /// "Working set selection using second order information", JMLR 6, 2005), until the KKT gap is
  /// below `target`, nothing improves, or `most` steps were taken.
  SmoSteps (*loop)(const SmoProblem<T>& problem, double target, std::int64_t most) = nullptr;
  /// totals = sum_q weights[q] rows[q], in double; `size` entries a row, whole cache lines.
  void (*combine)(const T* const* rows, const double* weights, std::size_t rows_count,
                  std::size_t size, double* totals) = nullptr;
};

/// For the widest instruction set of this machine, or the one that ForceTarget() chose.
template <typename T>
[[nodiscard]] SmoFunctions<T> BestSmoFunctions();

}  // namespace dfr::kernel::internal
