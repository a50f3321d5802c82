#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "gaussian_terms.h"

namespace dfr::kernel::internal {

/// The definition: sum_i weights_i exp(-gamma |x - points_i|^2), term by term.
[[nodiscard]] double GaussianSumReference(const core::Matrix& points,
                                          std::span<const double> weights, double gamma,
                                          std::span<const double> x) noexcept;

/// The same sum through the widest instruction set of this machine; `x` scaled by terms.Scale().
/// The order of summation depends on nothing but the number of terms and the instruction set.
/// Relative error of each term: 4e-16 + 2e-16 |exponent| in double, 3e-7 + 1e-7 |exponent| in
/// float, where terms below the smallest normal number count as zero.
template <typename T>
[[nodiscard]] T GaussianSum(const GaussianTerms<T>& terms, const T* x) noexcept;

/// The sum, with sum_i term_i (s'_i - x') written to `shift` (dim entries).
template <typename T>
T GaussianSumShift(const GaussianTerms<T>& terms, const T* x, T* shift) noexcept;

/// Every term by itself, as a row of the kernel matrix: `row` has num_blocks * kLanes entries,
/// aligned to 64 bytes; those beyond count are zero.
template <typename T>
void GaussianRow(const GaussianTerms<T>& terms, const T* x, T* row) noexcept;

/// The instruction sets that this build has and this machine runs, best first.
[[nodiscard]] std::vector<std::int64_t> SupportedTargets();
[[nodiscard]] const char* TargetName(std::int64_t target);
/// Restricts dispatch to one of SupportedTargets(), or lifts the restriction with 0. For tests and
/// benchmarks; not while another thread evaluates.
void ForceTarget(std::int64_t target);

}  // namespace dfr::kernel::internal
