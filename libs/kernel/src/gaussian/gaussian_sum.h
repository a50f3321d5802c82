#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "gaussian/gaussian_terms.h"
#include "gaussian/sum_block.h"

namespace dfr::kernel::internal {

/// Reference implementation of sum_i weights_i exp(-gamma |x - points_i|^2), term by term.
[[nodiscard]] double GaussianSumReference(const core::Matrix& points,
                                          std::span<const double> weights, double gamma,
                                          std::span<const double> x) noexcept;

/// Functions for the instruction set of ForceTarget(), by default the widest of this machine.
template <typename T>
[[nodiscard]] GaussianFunctions<T> BestFunctions();
template <typename T>
[[nodiscard]] SumFunctions<T> BestSumFunctions();

/// Returns the sum of all terms at an `x` that terms.Scale() has scaled, computed with SIMD. The
/// order of summation depends only on the number of terms and the instruction set.
/// Relative error of each term: 4e-16 + 2e-16 |exponent| in double, 3e-7 + 1e-7 |exponent| in
/// float. In float, terms below the smallest normal number count as zero.
template <typename T>
[[nodiscard]] T GaussianSum(const SumBlock<T>& terms, const T* x) noexcept {
  return terms.functions.sum(terms, x);
}

/// Writes GaussianSum() of `count` queries, concatenated in `x`, with the same bits.
template <typename T>
void GaussianSums(const SumBlock<T>& terms, const T* x, std::size_t count, T* sums) noexcept {
  terms.functions.sums(terms, x, count, sums);
}

/// Returns the sum of all terms times 2^offset and writes the sum of term_i 2^offset (s'_i - x') to
/// `shift` (dim entries). With offset 0, the sum has the bits of GaussianSum().
template <typename T>
T GaussianSumShift(const SumBlock<T>& terms, const T* x, T offset, T* shift) noexcept {
  return terms.functions.sum_shift(terms, x, offset, shift);
}

/// Returns the largest exponent log2 w_i - |x' - s'_i|^2. Its negative is the offset that prevents
/// underflow of GaussianSumShift() far from all points.
template <typename T>
[[nodiscard]] T LargestExponent(const SumBlock<T>& terms, const T* x) noexcept {
  return terms.functions.largest(terms, x);
}

/// Writes every term separately, as a row of the kernel matrix. `row` has num_blocks * kLanes
/// entries, aligned to 64 bytes; entries beyond the number of terms are zero.
template <typename T>
void GaussianRow(const GaussianTerms<T>& terms, const T* x, T* row) noexcept {
  terms.functions.row(terms, x, row);
}

/// Writes GaussianRow() of the points of all terms, which must have no weights, and each row's sum.
/// Computes only half of the values and copies the others. All have the bits of GaussianRow().
/// `rows` has num_blocks * kLanes rows, of which the last few are undefined. `sums` has one entry
/// per row; `point` provides dim entries of scratch memory.
template <typename T>
void AllGaussianRows(const GaussianTerms<T>& terms, T* point, T* rows, T* sums) noexcept {
  terms.functions.all_rows(terms, point, rows, sums);
}

/// Writes the exponents log2 w_i - |x' - s'_i|^2 of the terms of GaussianRow(), -infinity in the
/// padding.
template <typename T>
void ExponentRow(const GaussianTerms<T>& terms, const T* x, T* row) noexcept {
  terms.functions.exponents(terms, x, row);
}

/// row[i] = 2^(factor exponents[i]) for `size` entries that fill whole cache lines. Gives
/// GaussianRow() for another gamma without computing distances.
template <typename T>
void PowerRow(const GaussianTerms<T>& terms, const T* exponents, T factor, std::size_t size,
              T* row) noexcept {
  terms.functions.powers(exponents, factor, size, row);
}

/// totals[i] += sum_q weights[q] term_i(x_q) for the terms of the blocks [first, last), over
/// `count` queries, concatenated in `x`. `totals` has num_blocks * kLanes entries.
template <typename T>
void AddGaussianRows(const GaussianTerms<T>& terms, std::size_t first, std::size_t last, const T* x,
                     const T* weights, std::size_t count, double* totals) noexcept {
  terms.functions.add_rows(terms, first, last, x, weights, count, totals);
}

/// Writes the groups whose box is within sqrt(reach) of x to `groups`, ascending, and returns their
/// number. `groups` must have room for boxes.count entries, rounded up to a multiple of kLanes.
template <typename T>
[[nodiscard]] std::size_t NearGroups(const GaussianTerms<T>& terms, const GroupBoxes<T>& boxes,
                                     const T* x, T reach, std::uint32_t* groups) noexcept {
  return terms.functions.near_groups(boxes, x, reach, groups);
}

/// Same as GaussianRow(), for the terms of `count` groups. Keeps the groups in `groups` that hold a
/// term of at least 2^-reach and returns their number. `values` has GroupBoxes<T>::kGroup entries
/// per group, aligned to 64 bytes.
template <typename T>
[[nodiscard]] std::size_t NearRow(const GaussianTerms<T>& terms, const T* x, T reach,
                                  std::uint32_t* groups, std::size_t count, T* values) noexcept {
  return terms.functions.near_row(terms, x, reach, groups, count, values);
}

/// Writes the sum and the largest absolute entry of each column of a matrix with `dim` columns,
/// stored row by row. Sums add the rows in order. The largest entry ignores NaN.
void MeasureColumns(const double* rows, std::size_t count, std::size_t dim, double* sums,
                    double* most) noexcept;

/// Returns the instruction sets that this build contains and this machine supports, best first.
[[nodiscard]] std::vector<std::int64_t> SupportedTargets();
[[nodiscard]] const char* TargetName(std::int64_t target);
/// Restricts BestFunctions() and BestSumFunctions() to one of SupportedTargets(); 0 lifts the
/// restriction. For tests and benchmarks. Existing terms keep their functions.
void ForceTarget(std::int64_t target);

}  // namespace dfr::kernel::internal
