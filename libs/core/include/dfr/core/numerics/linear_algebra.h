#pragma once

#include <Eigen/Core>

namespace dfr::core {

// Products and decompositions of dense matrices by Eigen, compiled once, because each instantiation
// takes the compiler up to several seconds. All functions allocate. Matrices may have any size,
// including 0 x 0, unless documented otherwise. Thread-safe.

/// Returns the product a b. Copies a row-major matrix or an expression first.
[[nodiscard]] Eigen::MatrixXd Multiply(const Eigen::Ref<const Eigen::MatrixXd>& a,
                                       const Eigen::Ref<const Eigen::MatrixXd>& b);

/// Eigenvalues in ascending order, and their eigenvectors as columns.
struct SymmetricEigen {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
};

/// Decomposes a symmetric matrix by tridiagonalisation and QR. Reads only the lower triangle.
[[nodiscard]] SymmetricEigen DecomposeSymmetric(const Eigen::MatrixXd& a);

/// Solves a v = lambda b v for symmetric `a` and positive definite `b`. The eigenvectors satisfy
/// v' b v = 1.
/// @throws std::invalid_argument if `b` is not positive definite.
[[nodiscard]] SymmetricEigen DecomposeSymmetric(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b);

/// Returns the largest singular value of a matrix with at least one entry.
[[nodiscard]] double OperatorNorm(const Eigen::MatrixXd& a);

/// Solves a x = b for a positive or negative semidefinite matrix (pivoted Cholesky decomposition).
/// Reads only the lower triangle. If `a` is singular, x is one of the solutions, if there are any.
[[nodiscard]] Eigen::MatrixXd SolveSymmetric(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b);

/// Returns the shortest x among those that minimise |a x - b|^2 (complete orthogonal
/// decomposition).
[[nodiscard]] Eigen::MatrixXd SolveLeastSquares(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b);

/// Returns the Moore-Penrose inverse, which is the inverse of an invertible matrix.
[[nodiscard]] Eigen::MatrixXd PseudoInverse(const Eigen::MatrixXd& a);

/// Returns an orthonormal basis of the columns of `a`, in their order (QR decomposition without
/// pivoting). `a` must have at least as many rows as columns.
[[nodiscard]] Eigen::MatrixXd OrthonormalBasis(const Eigen::MatrixXd& a);

}  // namespace dfr::core
