#include "dfr/reduction/principal_components.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/random.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"

namespace dfr::reduction {
namespace {

using core::Matrix;
using testing::HasSubstr;

// Returns rows of rank `rank` with decreasing variances, different units and large means.
Matrix Rows(Eigen::Index n, Eigen::Index d, Eigen::Index rank, std::uint64_t seed) {
  core::Random random(seed);
  const auto normal = [&](Eigen::Index rows, Eigen::Index cols) {
    Matrix m(rows, cols);
    for (double& value : m.reshaped()) value = random.Normal();
    return m;
  };
  Matrix factors = normal(n, rank);
  for (Eigen::Index k = 0; k < rank; ++k) factors.col(k) *= std::pow(0.7, static_cast<double>(k));
  Matrix rows = factors * normal(rank, d);
  for (Eigen::Index j = 0; j < d; ++j) {
    rows.col(j) = (rows.col(j) * random.Uniform(0.01, 100.0)).array() + random.Uniform(-1e3, 1e3);
  }
  return rows;
}

Matrix Standardised(const Matrix& rows, const PrincipalComponents& fit) {
  Matrix a = rows.rowwise() - fit.mean.transpose();
  for (Eigen::Index j = 0; j < a.cols(); ++j) {
    a.col(j) *= fit.scale[j] > 0.0 ? 1.0 / fit.scale[j] : 0.0;
  }
  return a;
}

PrincipalComponents Fit(const Matrix& rows, const PrincipalComponentsOptions& options) {
  return FitPrincipalComponents(MatrixRows({&rows, 1}), options);
}

TEST(PrincipalComponentsTest, AreThoseOfAnExactDecomposition) {
  const Matrix rows = Rows(300, 200, 30, 1);
  const PrincipalComponents fit = Fit(rows, {.components = 8});
  const Matrix a = Standardised(rows, fit);
  const core::SymmetricEigen eigen = core::DecomposeSymmetric(a.transpose() * a / 300.0);
  const Eigen::VectorXd exact = eigen.values.reverse();
  ASSERT_EQ(fit.components.rows(), 8);
  // The products are in float.
  EXPECT_TRUE(test::AllClose(fit.variance, exact.head(8), 0.0, 1e-5));
  for (Eigen::Index k = 0; k < 8; ++k) {
    EXPECT_NEAR(std::abs(fit.components.row(k) * eigen.vectors.col(199 - k)), 1.0, 1e-6) << k;
  }
}

TEST(PrincipalComponentsTest, AreOrthonormalWithPositiveLargestEntriesAndTheirScores) {
  const Matrix rows = Rows(120, 90, 40, 2);
  const PrincipalComponents fit = Fit(rows, {.components = 12});
  EXPECT_TRUE(test::AllClose(Matrix(fit.components * fit.components.transpose()),
                             Matrix(Matrix::Identity(12, 12)), 1e-6));
  for (Eigen::Index k = 0; k < 12; ++k) {
    EXPECT_EQ(fit.components.row(k).cwiseAbs().maxCoeff(), fit.components.row(k).maxCoeff());
  }
  const Matrix scores = Standardised(rows, fit) * fit.components.transpose();
  EXPECT_TRUE(test::AllClose(fit.scores, scores, 1e-5));
  EXPECT_TRUE(test::AllClose(Eigen::VectorXd(scores.colwise().squaredNorm().transpose() / 120.0),
                             fit.variance, 0.0, 1e-5));
}

TEST(PrincipalComponentsTest, AreTheSameInOnePieceOrManyAndForAnyNumberOfThreads) {
  const Matrix whole = Rows(200, 22000, 20, 3);  // More rows than a block holds.
  const std::vector<Matrix> pieces = {whole.topRows(7), whole.middleRows(7, 150),
                                      whole.bottomRows(43)};
  const PrincipalComponentsOptions one{.components = 4, .oversampling = 4, .threads = 1};
  const PrincipalComponents fit = Fit(whole, one);
  for (const int threads : {1, 3}) {
    PrincipalComponentsOptions options = one;
    options.threads = threads;
    const PrincipalComponents other = FitPrincipalComponents(MatrixRows(pieces), options);
    EXPECT_TRUE(fit.components == other.components) << threads;
    EXPECT_TRUE(fit.scores == other.scores) << threads;
    EXPECT_TRUE(fit.mean == other.mean && fit.scale == other.scale) << threads;
  }
  const Matrix small = Rows(40, 60, 20, 3);
  EXPECT_FALSE(Fit(small, one).components ==
               Fit(small, {.components = 4, .oversampling = 4, .seed = 2}).components);
}

TEST(PrincipalComponentsTest, ConstantEntriesAreIgnoredAndNoiseKeptSmall) {
  Matrix rows = Rows(100, 20, 5, 5);
  core::Random random(6);
  for (Eigen::Index i = 0; i < 100; ++i) {
    rows(i, 3) = 0.1;
    rows.row(i).tail(4).setConstant(random.Normal());
    rows(i, 7) = 1e-3 * random.Normal();
  }
  const PrincipalComponents fit = Fit(rows, {.components = 5, .scale_floor = 0.5});
  EXPECT_EQ(fit.scale[3], 0.0);
  EXPECT_TRUE((fit.components.col(3).array() == 0.0).all());
  double square = 0.0;
  for (Eigen::Index j = 0; j < 20; ++j) {
    if (j != 3) square += (rows.col(j).array() - rows.col(j).mean()).square().mean();
  }
  EXPECT_NEAR(fit.scale[7], 0.5 * std::sqrt(square / 19.0), 1e-9 * fit.scale[7]);
}

TEST(PrincipalComponentsTest, AreNoMoreThanTheRankOfTheRows) {
  EXPECT_EQ(Fit(Rows(50, 40, 6, 7), {.components = 30}).components.rows(), 6);
  EXPECT_EQ(Fit(Rows(5, 40, 20, 8), {.components = 30}).components.rows(), 4);
  EXPECT_EQ(Fit(Rows(50, 3, 3, 9), {.components = 30}).components.rows(), 3);
}

TEST(PrincipalComponentsTest, BadInputIsRefusedWithItsPlace) {
  const auto message = [](const auto& call) { return test::MessageOf(call); };
  Matrix rows = Rows(10, 6, 3, 10);
  const auto fit = [&](const PrincipalComponentsOptions& options) {
    return message([&] { (void)Fit(rows, options); });
  };
  EXPECT_THAT(fit({.components = 0}), HasSubstr("components must be at least 1, not 0"));
  EXPECT_THAT(fit({.power_iterations = 0}), HasSubstr("power_iterations at least 1"));
  EXPECT_THAT(fit({.scale_floor = 1.5}), HasSubstr("scale_floor must lie in [0, 1], not 1.5"));
  rows(8, 4) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(fit({}), HasSubstr("entry 4 of row 8 is not finite"));
  rows = Matrix::Constant(4, 3, 7.0);
  EXPECT_THAT(fit({}), HasSubstr("all 4 rows are equal"));
  rows = Rows(1, 6, 3, 10);
  EXPECT_THAT(fit({}), HasSubstr("at least 2 rows"));
  const std::vector<Matrix> unequal = {Rows(3, 4, 2, 1), Rows(3, 5, 2, 1)};
  EXPECT_THAT(message([&] { (void)MatrixRows(unequal); }),
              HasSubstr("matrix 1 has 5 columns, but matrix 0 has 4"));
  EXPECT_THAT(message([] { (void)MatrixRows({}); }), HasSubstr("no rows"));
}

}  // namespace
}  // namespace dfr::reduction
