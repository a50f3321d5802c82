#include "dfr/core/numerics/linear_algebra.h"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

#include "dfr/core/matrix.h"
#include "tests/support/all_close.h"

namespace dfr::core {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using test::AllClose;

TEST(LinearAlgebraTest, ProductsMatchHandComputedValues) {
  const MatrixXd a{{1.0, 2.0}, {3.0, 4.0}, {5.0, 6.0}};
  const Matrix rows{{1.0, -1.0}, {0.0, 2.0}};  // row-major
  EXPECT_TRUE(AllClose(Multiply(a, rows), MatrixXd{{1.0, 3.0}, {3.0, 5.0}, {5.0, 7.0}}, 0.0));
  EXPECT_TRUE(
      AllClose(Multiply(a.topRows(1), a.bottomRows(2).transpose()), MatrixXd{{11.0, 17.0}}, 0.0));
  EXPECT_EQ(Multiply(MatrixXd(2, 0), MatrixXd(0, 3)), MatrixXd(MatrixXd::Zero(2, 3)));
}

TEST(LinearAlgebraTest, SymmetricMatricesAreDecomposedIntoAscendingEigenvalues) {
  // The upper triangle is not read.
  const MatrixXd a{{2.0, 99.0}, {1.0, 2.0}};
  const SymmetricEigen eigen = DecomposeSymmetric(a);
  EXPECT_TRUE(AllClose(eigen.values, VectorXd{{1.0, 3.0}}, 1e-15));
  EXPECT_NEAR(eigen.vectors(0, 0) * eigen.vectors(1, 0), -0.5, 1e-15);
  EXPECT_NEAR(eigen.vectors(0, 1) * eigen.vectors(1, 1), 0.5, 1e-15);
}

TEST(LinearAlgebraTest, PairsOfMatricesAreDecomposedRelativeToTheSecond) {
  const MatrixXd a{{8.0, 0.0}, {0.0, 3.0}};
  const MatrixXd b{{4.0, 0.0}, {0.0, 1.0}};
  const SymmetricEigen eigen = DecomposeSymmetric(a, b);
  EXPECT_TRUE(AllClose(eigen.values, VectorXd{{2.0, 3.0}}, 1e-14));
  const MatrixXd gram = Multiply(Multiply(eigen.vectors.transpose(), b), eigen.vectors);
  EXPECT_TRUE(AllClose(gram, MatrixXd(MatrixXd::Identity(2, 2)), 1e-14));
  EXPECT_THROW((void)DecomposeSymmetric(a, -b), std::invalid_argument);
}

TEST(LinearAlgebraTest, NormAndInversesMatchHandComputedValues) {
  const MatrixXd a{{3.0, 0.0}, {4.0, 5.0}};  // Singular values sqrt(45) and sqrt(5).
  EXPECT_NEAR(OperatorNorm(a), std::sqrt(45.0), 1e-14);
  EXPECT_TRUE(AllClose(PseudoInverse(a), MatrixXd{{1.0 / 3.0, 0.0}, {-4.0 / 15.0, 0.2}}, 1e-15));
  const MatrixXd row{{3.0, 4.0}};
  EXPECT_TRUE(AllClose(PseudoInverse(row), MatrixXd{{0.12}, {0.16}}, 1e-15));
}

TEST(LinearAlgebraTest, SolutionsSatisfyTheirEquations) {
  const MatrixXd a{{4.0, 2.0}, {2.0, 3.0}};
  const VectorXd b{{8.0, 8.0}};
  EXPECT_TRUE(AllClose(SolveSymmetric(a, b), MatrixXd{{1.0}, {2.0}}, 1e-15));
  // The least-squares fit of a constant is the mean.
  const MatrixXd ones = MatrixXd::Ones(3, 1);
  EXPECT_TRUE(AllClose(SolveLeastSquares(ones, VectorXd{{1.0, 2.0, 6.0}}), MatrixXd{{3.0}}, 1e-15));
  // Two equal columns share the constant.
  const MatrixXd twice = MatrixXd::Ones(3, 2);
  EXPECT_TRUE(
      AllClose(SolveLeastSquares(twice, VectorXd{{1.0, 2.0, 6.0}}), MatrixXd{{1.5}, {1.5}}, 1e-14));
}

TEST(LinearAlgebraTest, BasisSpansTheColumnsInOrder) {
  const MatrixXd a{{3.0, 1.0}, {4.0, 1.0}, {0.0, 2.0}};
  const MatrixXd q = OrthonormalBasis(a);
  ASSERT_EQ(q.rows(), 3);
  ASSERT_EQ(q.cols(), 2);
  const MatrixXd gram = Multiply(q.transpose(), q);
  EXPECT_TRUE(AllClose(gram, MatrixXd(MatrixXd::Identity(2, 2)), 1e-15));
  EXPECT_NEAR(std::abs(q.col(0).dot(a.col(0))), 5.0, 1e-14);
  EXPECT_TRUE(AllClose(Multiply(q, Multiply(q.transpose(), a)), a, 1e-14));
}

}  // namespace
}  // namespace dfr::core
