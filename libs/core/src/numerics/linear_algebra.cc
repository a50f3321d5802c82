#include "dfr/core/numerics/linear_algebra.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <cmath>

#include "dfr/core/contract.h"

namespace dfr::core {

Eigen::MatrixXd Multiply(const Eigen::Ref<const Eigen::MatrixXd>& a,
                         const Eigen::Ref<const Eigen::MatrixXd>& b) {
  return a * b;
}

SymmetricEigen DecomposeSymmetric(const Eigen::MatrixXd& a) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> solver(a);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

SymmetricEigen DecomposeSymmetric(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  DFR_THROW_UNLESS(b.llt().info() == Eigen::Success, "the matrix b is not positive definite");
  const Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd> solver(a, b);
  return {solver.eigenvalues(), solver.eigenvectors()};
}

double OperatorNorm(const Eigen::MatrixXd& a) {
  return std::sqrt(DecomposeSymmetric(Multiply(a, a.transpose())).values.maxCoeff());
}

Eigen::MatrixXd SolveSymmetric(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  return a.ldlt().solve(b);
}

Eigen::MatrixXd SolveLeastSquares(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  return a.completeOrthogonalDecomposition().solve(b);
}

Eigen::MatrixXd PseudoInverse(const Eigen::MatrixXd& a) {
  return SolveLeastSquares(a, Eigen::MatrixXd::Identity(a.rows(), a.rows()));
}

Eigen::MatrixXd OrthonormalBasis(const Eigen::MatrixXd& a) {
  const Eigen::HouseholderQR<Eigen::MatrixXd> qr(a);
  Eigen::MatrixXd q = Eigen::MatrixXd::Identity(a.rows(), a.cols());
  q.applyOnTheLeft(qr.householderQ());
  return q;
}

}  // namespace dfr::core
