#include "gaussian/gaussian_sum.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "gaussian/gaussian_terms.h"
#include "tests/kernel/gaussian/gaussian_problem.h"

namespace dfr::kernel::internal {
namespace {

// Every test runs once with each instruction set that this machine has.
class GaussianSumTest : public testing::TestWithParam<std::int64_t> {
 protected:
  void SetUp() override { ForceTarget(GetParam()); }
  void TearDown() override { ForceTarget(0); }
};

// Numbers of terms around every group size of the unrolled loops, with and without a partial block.
constexpr int kCounts[] = {1, 2, 7, 8, 9, 16, 17, 24, 31, 32, 33, 63, 64, 65, 127, 128, 129, 600};

// Checks that sums differ from the definition by at most `tolerance` of the sum. Differences of
// states are at most `reach` in each coordinate, and their weighted sums differ by at most `reach`
// times as much.
template <typename T>
void CheckAgainstLongDouble(int dim, double gamma, double spread, double tolerance, double reach) {
  core::Random random(11);
  for (const int m : kCounts) {
    SCOPED_TRACE(testing::Message() << m << " x " << dim);
    const Problem p(m, dim, gamma, static_cast<std::uint64_t>(m * 100 + dim));
    const GaussianTerms<T> terms(p.points, p.weights, p.gamma);
    const SumTerms<T> sums(terms);
    std::vector<double> x(static_cast<std::size_t>(dim));
    std::vector<T> scaled(x.size()), shift(x.size());
    for (int query = 0; query < 10; ++query) {
      for (double& v : x) v = spread * random.Normal();
      const Reference expected = LongDouble(p, x);
      const auto sum = static_cast<double>(expected.sum);
      ASSERT_TRUE(terms.Scale(x.data(), scaled.data()));
      EXPECT_NEAR(GaussianSum(*sums, scaled.data()), sum, tolerance * sum);
      EXPECT_NEAR(GaussianSumShift(*sums, scaled.data(), T{0}, shift.data()), sum, tolerance * sum);
      for (std::size_t k = 0; k < x.size(); ++k) {
        EXPECT_NEAR(shift[k] / terms.scale, static_cast<double>(expected.shift[k]),
                    reach * tolerance * sum);
      }
      if constexpr (sizeof(T) == sizeof(double)) {
        EXPECT_NEAR(GaussianSumReference(p.points, p.weights, p.gamma, x), sum, tolerance * sum);
      }
    }
  }
}

TEST_P(GaussianSumTest, SumsAgreeWithLongDouble) {
  // Exponents are at most 60, and each of a term's d + 1 roundings is 1.1e-16 times the exponent.
  for (const int dim : {1, 3, 4, 9}) CheckAgainstLongDouble<double>(dim, 0.7, 1.5, 4e-14, 8.0);
  // Exponents of the terms that matter are below 10: 3e-7 + 10 * 1e-7.
  CheckAgainstLongDouble<float>(9, 1.0 / 9.0, 1.0, 1.3e-6, 6.0);
}

// Checks that the relative error of one term is within the documented bound, for exponents from 0
// to below the exponent of the smallest normal number.
template <typename T>
void CheckExponents(double polynomial, double per_exponent) {
  core::Matrix points(1, 1);
  points(0, 0) = 0.0;
  const GaussianTerms<T> terms(points, {}, 1.0 / std::numbers::log2e);
  const SumTerms<T> sums(terms);
  const double lowest = std::numeric_limits<T>::min_exponent;
  double worst = 0.0;
  for (int i = 0; i <= 40000; ++i) {
    const T x = static_cast<T>(std::sqrt(-lowest * 1.05 * i / 40000.0));
    const long double exponent = -static_cast<long double>(x) * x;
    const T actual = GaussianSum(*sums, &x);
    if (exponent < lowest) {
      EXPECT_LE(actual, 2 * std::numeric_limits<T>::min());
      continue;
    }
    const long double expected = std::exp2(exponent);
    const auto error = static_cast<double>(std::abs(actual - expected) / expected);
    worst = std::max(worst, error / (polynomial - per_exponent * static_cast<double>(exponent)));
  }
  EXPECT_LE(worst, 1.0);
}

TEST_P(GaussianSumTest, ErrorOfOneTermIsAsDocumented) {
  CheckExponents<double>(4e-16, 2e-16);
  CheckExponents<float>(3e-7, 1e-7);
}

TEST_P(GaussianSumTest, ATermAtItsPointEqualsItsWeight) {
  core::Matrix points(1, 3);
  points << 0.3, -7.0, 1e6;
  const GaussianTerms<double> terms(points, {}, 5.0);
  const SumTerms<double> sums(terms);
  std::vector<double> scaled(3);
  ASSERT_TRUE(terms.Scale(points.data(), scaled.data()));
  EXPECT_EQ(GaussianSum(*sums, scaled.data()), 1.0);
}

TEST_P(GaussianSumTest, RowHoldsEachTermAndThePaddingIsZero) {
  const Problem p(37, 5, 0.4, 3);
  const GaussianTerms<double> terms(p.points, {}, p.gamma);
  AlignedVector<double> row(terms.num_blocks * terms.kLanes, -1.0);
  std::vector<double> scaled(5);
  ASSERT_TRUE(terms.Scale(p.points.data(), scaled.data()));
  GaussianRow(terms, scaled.data(), row.data());
  EXPECT_EQ(row[0], 1.0);
  for (int i = 0; i < 37; ++i) {
    const double squared = (p.points.row(i) - p.points.row(0)).squaredNorm();
    // Exponents reach 30: see SumsAgreeWithLongDouble.
    EXPECT_NEAR(row[static_cast<std::size_t>(i)], std::exp(-0.4 * squared), 1e-14);
  }
  for (std::size_t i = 37; i < row.size(); ++i) EXPECT_EQ(row[i], 0.0);
}

template <typename T>
void CheckAllRows(int count, int dim) {
  const Problem p(count, dim, 0.4, 3);
  const GaussianTerms<T> terms(p.points, {}, p.gamma);
  const std::size_t size = terms.row_size();
  AlignedVector<T> rows(size * size, T{-1});
  AlignedVector<T> row(size);
  std::vector<T> point(terms.dim), sums(terms.count);
  AllGaussianRows(terms, point.data(), rows.data(), sums.data());
  for (std::size_t i = 0; i < terms.count; ++i) {
    terms.Point(i, point.data());
    GaussianRow(terms, point.data(), row.data());
    double sum = 0.0;
    for (std::size_t j = 0; j < size; ++j) {
      EXPECT_EQ(rows[i * size + j], row[j]) << i << ' ' << j;
      sum += static_cast<double>(row[j]);
    }
    EXPECT_NEAR(static_cast<double>(sums[i]), sum, sum * (sizeof(T) == 4 ? 1e-5 : 1e-13));
  }
}

TEST_P(GaussianSumTest, AllRowsAtOnceHaveTheBitsOfSingleRows) {
  for (const int count : {1, 16, 37, 250}) {
    CheckAllRows<float>(count, 5);
    CheckAllRows<double>(count, 5);
  }
}

TEST_P(GaussianSumTest, FarQueriesAreZeroAndNonFiniteOnesAreRefused) {
  const Problem p(20, 2, 5.0, 4);
  const GaussianTerms<double> terms(p.points, p.weights, p.gamma);
  const SumTerms<double> sums(terms);
  std::vector<double> scaled(2), shift(2);
  for (const double far : {30.0, 1e10, 1e149}) {
    const std::vector<double> x = {far, -far};
    ASSERT_TRUE(terms.Scale(x.data(), scaled.data()));
    EXPECT_LE(GaussianSum(*sums, scaled.data()), 1e-300);
    EXPECT_LE(GaussianSumShift(*sums, scaled.data(), 0.0, shift.data()), 1e-300);
    EXPECT_TRUE(std::isfinite(shift[0]) && std::isfinite(shift[1]));
  }
  for (const double bad :
       {1e200, std::numeric_limits<double>::infinity(), std::numeric_limits<double>::quiet_NaN()}) {
    const std::vector<double> x = {0.0, bad};
    EXPECT_FALSE(terms.Scale(x.data(), scaled.data()));
  }
}

// Checks that no term is denormal. Arithmetic with denormal numbers takes more than a hundred
// cycles per vector on Intel processors.
template <typename T>
void CheckSmallTerms() {
  // Smallest exponent of a normal number.
  constexpr double kLeast = std::numeric_limits<T>::min_exponent - 1;
  constexpr int kCount = 801;
  core::Matrix points(kCount, 1);
  for (int i = 0; i < kCount; ++i) points(i, 0) = std::sqrt(-kLeast - 10.0 + 0.05 * i);
  const GaussianTerms<T> terms(points, {}, std::numbers::ln2);  // 2^-|x - s|^2
  const SumTerms<T> sums(terms);
  AlignedVector<T> row(terms.row_size());
  const double origin = 0.0;
  std::vector<T> scaled(1), shift(1);
  ASSERT_TRUE(terms.Scale(&origin, scaled.data()));
  GaussianRow(terms, scaled.data(), row.data());
  for (int i = 0; i < kCount; ++i) {
    const double exponent = -points(i, 0) * points(i, 0);
    const T term = row[static_cast<std::size_t>(i)];
    if (exponent < kLeast - 0.01) {
      EXPECT_EQ(term, T{0}) << exponent;
    } else if (exponent > kLeast + 0.01) {
      EXPECT_NEAR(std::log2(static_cast<double>(term)), exponent, 1e-3);
    }
    EXPECT_TRUE(term == T{0} || std::isnormal(term)) << exponent;
  }
  // Sums contain the remaining terms only.
  double sum = 0.0;
  for (const T term : row) sum += static_cast<double>(term);
  EXPECT_NEAR(static_cast<double>(GaussianSum(*sums, scaled.data())), sum, 1e-5 * sum);
  EXPECT_NEAR(static_cast<double>(GaussianSumShift(*sums, scaled.data(), T{0}, shift.data())), sum,
              1e-5 * sum);
}

TEST_P(GaussianSumTest, ATermIsZeroOrANormalNumber) {
  CheckSmallTerms<float>();
  CheckSmallTerms<double>();
}

TEST_P(GaussianSumTest, ColumnsAreMeasuredByTheirDefinition) {
  core::Random random(17);
  for (std::size_t dim = 1; dim <= 40; ++dim) {
    for (const std::size_t count : {1u, 2u, 3u, 17u}) {
      // No spare entries: the sanitizers detect a read beyond the end.
      std::vector<double> rows(count * dim), sums(dim), most(dim);
      for (double& v : rows) v = random.Normal();
      MeasureColumns(rows.data(), count, dim, sums.data(), most.data());
      for (std::size_t k = 0; k < dim; ++k) {
        double sum = 0.0;
        double largest = 0.0;
        for (std::size_t i = 0; i < count; ++i) {
          sum += rows[i * dim + k];
          largest = std::max(largest, std::abs(rows[i * dim + k]));
        }
        ASSERT_EQ(sums[k], sum) << count << " x " << dim << ", column " << k;
        ASSERT_EQ(most[k], largest) << count << " x " << dim << ", column " << k;
      }
    }
  }
}

// The system tier tests a million states.
TEST(GaussianSumTargetsTest, GIsAccurateOnRandomAndAdversarialStates) { CheckDecisions(4000); }

// Instruction sets add terms in different orders, so their sums differ by rounding.
TEST(GaussianSumTargetsTest, InstructionSetsDifferByRoundingOnly) {
  const Problem p(600, 9, 1.0 / 9.0, 15);
  core::Random random(16);
  std::vector<double> x(9), scaled(9);
  std::vector<float> scaled_float(9);
  const auto& [in_double, in_float] = OfEveryTarget(p);
  for (int i = 0; i < 400; ++i) {
    for (double& v : x) v = random.Normal();
    ASSERT_TRUE(in_double[0]->Scale(x.data(), scaled.data()));
    ASSERT_TRUE(in_float[0]->Scale(x.data(), scaled_float.data()));
    const double best = GaussianSum(*in_double[0], scaled.data());
    for (std::size_t k = 1; k < in_double.size(); ++k) {
      EXPECT_NEAR(GaussianSum(*in_double[k], scaled.data()), best, 1e-14 * best);
      EXPECT_NEAR(GaussianSum(*in_float[k], scaled_float.data()),
                  GaussianSum(*in_float[0], scaled_float.data()), 1e-6 * best);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Targets, GaussianSumTest, testing::ValuesIn(SupportedTargets()),
                         [](const auto& test) { return std::string(TargetName(test.param)); });

}  // namespace
}  // namespace dfr::kernel::internal
