#pragma once

#include <Eigen/Core>
#include <span>

// Eigen's alignment and deallocation depend on the vector flags of each program (-march=native). A
// library that frees memory allocated under other flags crashes. The name of this variable encodes
// the alignment, and the libraries define only their variant: incompatible programs do not link.
// See docs/packages.md for the remedy.
#define DFR_EIGEN_ALIGNMENT_OF(bytes, malloc_aligns) \
  dfr_eigen_alignment_##bytes##_##malloc_aligns##_see_docs_packages_march
#define DFR_EIGEN_ALIGNMENT(bytes, malloc_aligns) DFR_EIGEN_ALIGNMENT_OF(bytes, malloc_aligns)
extern "C" const char DFR_EIGEN_ALIGNMENT(EIGEN_MAX_ALIGN_BYTES, EIGEN_MALLOC_ALREADY_ALIGNED);

namespace dfr::core {

namespace internal {
[[gnu::used]] inline const char* const kEigenAlignment =
    &DFR_EIGEN_ALIGNMENT(EIGEN_MAX_ALIGN_BYTES, EIGEN_MALLOC_ALREADY_ALIGNED);
}  // namespace internal

/// Samples and trajectories: one state or control per row, rows contiguous as in NumPy.
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Returns row `i` of a matrix without a copy. Valid as long as the matrix exists.
[[nodiscard]] inline std::span<const double> Row(const Matrix& m, Eigen::Index i) noexcept {
  return {m.data() + i * m.cols(), static_cast<std::size_t>(m.cols())};
}
[[nodiscard]] inline std::span<double> Row(Matrix& m, Eigen::Index i) noexcept {
  return {m.data() + i * m.cols(), static_cast<std::size_t>(m.cols())};
}

/// Returns a vector as a span, the argument type of the control loop's interfaces, without a copy.
[[nodiscard]] inline std::span<const double> AsSpan(const Eigen::VectorXd& v) noexcept {
  return {v.data(), static_cast<std::size_t>(v.size())};
}
[[nodiscard]] inline std::span<double> AsSpan(Eigen::VectorXd& v) noexcept {
  return {v.data(), static_cast<std::size_t>(v.size())};
}

/// Returns a span as an Eigen vector, without a copy.
[[nodiscard]] inline Eigen::Map<const Eigen::VectorXd> AsVector(
    std::span<const double> v) noexcept {
  return {v.data(), static_cast<Eigen::Index>(v.size())};
}
[[nodiscard]] inline Eigen::Map<Eigen::VectorXd> AsVector(std::span<double> v) noexcept {
  return {v.data(), static_cast<Eigen::Index>(v.size())};
}

/// Returns true if no entry is NaN or infinite; true for no entries.
[[nodiscard]] inline bool AllFinite(std::span<const double> v) noexcept {
  // A product of zero and a non-finite entry is NaN, and so is the sum. Eigen computes the sum with
  // vector instructions.
  return (0.0 * AsVector(v).array()).sum() == 0.0;
}

}  // namespace dfr::core
