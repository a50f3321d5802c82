#pragma once

#include <Eigen/Core>
#include <span>

namespace dfr::core {

/// Samples and trajectories: one state or control per row, rows contiguous, as NumPy lays them out.
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Row `i` of a matrix, without a copy. Valid as long as the matrix is.
[[nodiscard]] inline std::span<const double> Row(const Matrix& m, Eigen::Index i) noexcept {
  return {m.data() + i * m.cols(), static_cast<std::size_t>(m.cols())};
}
[[nodiscard]] inline std::span<double> Row(Matrix& m, Eigen::Index i) noexcept {
  return {m.data() + i * m.cols(), static_cast<std::size_t>(m.cols())};
}

/// A vector as the span that the control loop's interfaces take, without a copy.
[[nodiscard]] inline std::span<const double> AsSpan(const Eigen::VectorXd& v) noexcept {
  return {v.data(), static_cast<std::size_t>(v.size())};
}
[[nodiscard]] inline std::span<double> AsSpan(Eigen::VectorXd& v) noexcept {
  return {v.data(), static_cast<std::size_t>(v.size())};
}

/// A span as an Eigen vector, without a copy.
[[nodiscard]] inline Eigen::Map<const Eigen::VectorXd> AsVector(
    std::span<const double> v) noexcept {
  return {v.data(), static_cast<Eigen::Index>(v.size())};
}
[[nodiscard]] inline Eigen::Map<Eigen::VectorXd> AsVector(std::span<double> v) noexcept {
  return {v.data(), static_cast<Eigen::Index>(v.size())};
}

}  // namespace dfr::core
