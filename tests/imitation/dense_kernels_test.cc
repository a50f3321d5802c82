#include "mlp/dense_kernels.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "hwy/highway.h"
#include "tests/support/all_close.h"
#include "tests/support/random_matrix.h"

namespace dfr::imitation::internal {
namespace {

using test::RandomMatrix;

// Every test runs on each instruction set that this machine has.
class DenseKernelsTest : public testing::TestWithParam<std::int64_t> {
 protected:
  DenseKernelsTest() { hwy::GetChosenTarget().Update(GetParam()); }
  ~DenseKernelsTest() override { hwy::GetChosenTarget().DeInit(); }
};

Product Of(const core::Matrix& a, const core::Matrix& b, core::Matrix& c) {
  return {.m = static_cast<int>(a.rows()),
          .n = static_cast<int>(b.cols()),
          .k = static_cast<int>(a.cols()),
          .a = a.data(),
          .a_row = a.cols(),
          .a_col = 1,
          .b = b.data(),
          .b_row = b.cols(),
          .c = c.data(),
          .c_row = c.cols()};
}

// Shapes around every tile edge. C's entries are sums of at most 34 terms of size around 1: 1e-13
// is 10 times the difference of reordering and fused rounding.
TEST_P(DenseKernelsTest, ProductsMatchTheDefinition) {
  core::Random random(1);
  for (const int m : {1, 2, 5, 6, 7, 13}) {
    for (const int n : {1, 2, 3, 4, 7, 8, 9, 15, 16, 31, 33, 64, 71}) {
      for (const int k : {0, 1, 5, 33}) {
        SCOPED_TRACE(testing::Message() << m << " x " << k << " times " << k << " x " << n);
        const core::Matrix a = RandomMatrix(random, m, k);
        const core::Matrix b = RandomMatrix(random, k, n);
        const core::Matrix bias = RandomMatrix(random, 1, n);
        const core::Matrix start = RandomMatrix(random, m, n);

        core::Matrix actual = start, expected = start;
        Multiply(Of(a, b, actual));
        for (int i = 0; i < m; ++i) {
          for (int j = 0; j < n; ++j) expected(i, j) = a.row(i).dot(b.col(j));
        }
        EXPECT_TRUE(test::AllClose(actual, expected, 1e-13));

        Product with_bias = Of(a, b, actual);
        with_bias.bias = bias.data();
        Multiply(with_bias);
        expected.rowwise() += bias.row(0);
        EXPECT_TRUE(test::AllClose(actual, expected, 1e-13));

        Product added = Of(a, b, actual = start);
        added.accumulate = true;
        Multiply(added);
        EXPECT_TRUE(test::AllClose(actual, start + a * b, 1e-13));
      }
    }
  }
}

TEST_P(DenseKernelsTest, StridesExpressTransposedAndConstantLeftFactors) {
  core::Random random(2);
  const core::Matrix a = RandomMatrix(random, 11, 7);
  const core::Matrix b = RandomMatrix(random, 11, 9);
  core::Matrix c(7, 9);
  Product product = Of(a.transpose(), b, c);
  product.a = a.data();
  product.a_row = 1;
  product.a_col = a.cols();
  Multiply(product);
  EXPECT_TRUE(test::AllClose(c, a.transpose() * b, 1e-14));

  const double one = 1.0;
  product.m = 1;
  product.a = &one;
  product.a_row = 0;
  product.a_col = 0;
  Multiply(product);
  EXPECT_TRUE(test::AllClose(c.row(0), b.colwise().sum(), 1e-14));
}

TEST_P(DenseKernelsTest, NothingBeyondTheTileIsWritten) {
  core::Random random(3);
  for (const int n : {1, 3, 7, 13}) {
    const core::Matrix a = RandomMatrix(random, 3, 4);
    const core::Matrix b = RandomMatrix(random, 4, n);
    core::Matrix c = core::Matrix::Constant(4, n + 5, 99.0);
    Product product = Of(a, b, c);
    product.c_row = n + 5;
    Multiply(product);
    EXPECT_TRUE((c.rightCols(5).array() == 99.0).all());
    EXPECT_TRUE((c.bottomRows(1).array() == 99.0).all());
    EXPECT_TRUE(test::AllClose(c.topLeftCorner(3, n), a * b, 1e-14));
  }
}

// A row's result does not depend on the batch around it, to the last bit.
TEST_P(DenseKernelsTest, RowsOfABatchEqualSingleRows) {
  core::Random random(4);
  for (const int n : {7, 64}) {
    const core::Matrix a = RandomMatrix(random, 13, 33);
    const core::Matrix b = RandomMatrix(random, 33, n);
    core::Matrix batch(13, n), alone(1, n);
    Multiply(Of(a, b, batch));
    Tanh(batch.data(), static_cast<std::size_t>(batch.size()));
    for (Eigen::Index i = 0; i < a.rows(); ++i) {
      const core::Matrix row = a.row(i);
      Multiply(Of(row, b, alone));
      Tanh(alone.data(), static_cast<std::size_t>(alone.size()));
      EXPECT_EQ(alone.row(0), batch.row(i)) << "row " << i;
    }
  }
}

// 4 units in the last place are at most 8.9e-16 relative. The size is odd: the last vector is
// partial.
TEST_P(DenseKernelsTest, TanhIsWithinFourUnitsInTheLastPlace) {
  std::vector<double> x = {0.0,  -0.0,  5e-324, 1e-300,
                           1e-8, 19.0,  19.1,   20.0,
                           25.0, 710.0, 1e300,  std::numeric_limits<double>::infinity()};
  core::Random random(5);
  for (int i = 0; i < 50000; ++i) {
    x.push_back(random.Uniform(-22.0, 22.0));
    x.push_back(std::exp(random.Uniform(-40.0, 3.0)));
  }
  for (std::size_t i = 0; i < 12; ++i) x.push_back(-x[i]);
  x.push_back(0.35);
  std::vector<double> actual = x, expected = x;
  Tanh(actual.data(), actual.size());
  for (double& value : expected) value = std::tanh(value);
  EXPECT_TRUE(test::AllClose(core::AsVector(std::span<const double>(actual)),
                             core::AsVector(std::span<const double>(expected)), 0.0, 8.9e-16));
  for (std::size_t i = 0; i < x.size(); ++i) ASSERT_EQ(std::signbit(actual[i]), std::signbit(x[i]));
}

TEST_P(DenseKernelsTest, TanhOfNanIsNan) {
  for (std::size_t at = 0; at < 9; ++at) {
    std::vector<double> x(9, 0.5);
    x[at] = std::numeric_limits<double>::quiet_NaN();
    Tanh(x.data(), x.size());
    for (std::size_t i = 0; i < x.size(); ++i) EXPECT_EQ(std::isnan(x[i]), i == at);
  }
}

TEST_P(DenseKernelsTest, SlopesMatchTheDefinition) {
  core::Random random(6);
  for (const int size : {1, 2, 7, 8, 9, 64}) {
    core::Matrix actual = RandomMatrix(random, 1, size);
    core::Matrix expected = actual;
    const core::Matrix activations = RandomMatrix(random, 1, size).array().tanh().matrix();
    const auto count = static_cast<std::size_t>(size);
    TimesTanhSlope(actual.data(), activations.data(), count);
    expected.array() *= 1.0 - activations.array().square();
    EXPECT_TRUE(test::AllClose(actual, expected, 1e-15));
  }
}

std::vector<std::int64_t> Targets() { return hwy::SupportedAndGeneratedTargets(); }

INSTANTIATE_TEST_SUITE_P(Targets, DenseKernelsTest, testing::ValuesIn(Targets()),
                         [](const auto& target) { return hwy::TargetName(target.param); });

}  // namespace
}  // namespace dfr::imitation::internal
