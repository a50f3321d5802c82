#pragma once

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <cstdlib>

namespace dfr::test {

/// Scales every tolerance: DFR_TOL_SCALE=0 makes each comparison print its true error.
inline double ToleranceScale() {
  const char* scale = std::getenv("DFR_TOL_SCALE");
  return scale == nullptr ? 1.0 : std::strtod(scale, nullptr);
}

/// Succeeds if |actual - expected| <= absolute + relative * |expected| for every entry. Prints the
/// worst entry on failure. NaN is never close.
template <typename A, typename B>
testing::AssertionResult AllClose(const Eigen::MatrixBase<A>& actual,
                                  const Eigen::MatrixBase<B>& expected, double absolute,
                                  double relative = 0.0) {
  if (actual.rows() != expected.rows() || actual.cols() != expected.cols()) {
    return testing::AssertionFailure()
           << "shapes differ: " << actual.rows() << " x " << actual.cols() << " and "
           << expected.rows() << " x " << expected.cols();
  }
  Eigen::Index row = 0;
  Eigen::Index col = 0;
  double worst = 0.0;
  for (Eigen::Index i = 0; i < actual.rows(); ++i) {
    for (Eigen::Index j = 0; j < actual.cols(); ++j) {
      if (actual(i, j) == expected(i, j)) continue;  // equal infinities are also equal
      const double bound = ToleranceScale() * (absolute + relative * std::abs(expected(i, j)));
      const double excess = std::abs(actual(i, j) - expected(i, j)) - bound;
      if (!(excess <= worst)) {
        worst = excess;
        row = i;
        col = j;
        if (std::isnan(excess)) break;
      }
    }
  }
  if (worst == 0.0) return testing::AssertionSuccess();
  return testing::AssertionFailure()
         << "entry (" << row << ", " << col << "): " << actual(row, col) << " is not "
         << expected(row, col) << ", they differ by " << actual(row, col) - expected(row, col);
}

}  // namespace dfr::test
