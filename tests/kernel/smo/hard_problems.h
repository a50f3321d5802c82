// Problems over all valid arguments: sizes, kernel widths, nu, duplicates, clusters, scales,
// outliers. The results of a fit are checked against their definition.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"

namespace dfr::kernel::test {

// Returns the sum over rows p of `vectors` of alpha exp(-gamma |x - p|^2), for each row x of
// `samples`. Leaves out exponentials below 1e-17: alpha sums to 1, so these terms sum to less than
// 1e-17. Without "flatten", -Og compiles each operation as a call.
[[gnu::flatten]] inline Eigen::VectorXd Gradients(const core::Matrix& samples,
                                                  const core::Matrix& vectors,
                                                  const Eigen::VectorXd& alpha, double gamma) {
  const Eigen::ArrayXXd columns = vectors.array();
  Eigen::ArrayXd squared(vectors.rows());
  Eigen::ArrayXd exponents(vectors.rows());
  Eigen::ArrayXd weights(vectors.rows());
  Eigen::VectorXd gradients(samples.rows());
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    squared.setZero();
    for (Eigen::Index k = 0; k < samples.cols(); ++k) {
      squared += (columns.col(k) - samples(i, k)).square();
    }
    Eigen::Index near = 0;
    for (Eigen::Index p = 0; p < squared.size(); ++p) {
      exponents[near] = -gamma * squared[p];
      weights[near] = alpha[p];
      near += exponents[near] > -39.2 ? 1 : 0;
    }
    gradients[i] = (weights.head(near) * exponents.head(near).exp()).sum();
  }
  return gradients;
}

// Returns max G over alpha > 0 minus min G over alpha < 1 in LIBSVM's scale, for the alpha of the
// summary.
inline double KktGap(const Eigen::VectorXd& gradients, const FitSummary& summary, double nu) {
  const double total = nu * static_cast<double>(gradients.size());
  double largest = -std::numeric_limits<double>::infinity();
  double smallest = std::numeric_limits<double>::infinity();
  for (Eigen::Index i = 0; i < gradients.size(); ++i) {
    if (summary.alpha[i] > 0.0) largest = std::max(largest, total * gradients[i]);
    if (total * summary.alpha[i] < 1.0 - 1e-12) {
      smallest = std::min(smallest, total * gradients[i]);
    }
  }
  return std::isinf(smallest) ? 0.0 : std::max(0.0, largest - smallest);
}

inline double GapOf(const OneClassSvm& svm, const FitSummary& summary, const core::Matrix& samples,
                    double nu) {
  return KktGap(Gradients(samples, svm.support_vectors(), svm.alpha(), svm.gamma()), summary, nu);
}

// Fits, and expects convergence and a KKT gap, computed from its definition, below the tolerance
// plus `rounding`.
inline OneClassSvm FitToTheGap(const core::Matrix& samples, const OneClassSvmOptions& options,
                               double rounding = 0.0, FitSummary* out = nullptr) {
  FitSummary summary;
  OneClassSvm svm = OneClassSvm::Fit(samples, options, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged) << summary.kkt_gap;
  EXPECT_LT(summary.kkt_gap, options.tolerance);
  EXPECT_LT(GapOf(svm, summary, samples, options.nu), options.tolerance + rounding);
  EXPECT_TRUE(std::isfinite(svm.rho()));
  EXPECT_NEAR(svm.alpha().sum(), 1.0, 1e-12);
  if (out != nullptr) *out = summary;
  return svm;
}

inline double MedianSquaredDistance(const core::Matrix& samples) {
  std::vector<double> squared;
  const Eigen::Index step = std::max<Eigen::Index>(1, samples.rows() / 50);
  for (Eigen::Index i = 0; i < samples.rows(); i += step) {
    for (Eigen::Index j = 0; j < i; j += step) {
      const double square = (samples.row(i) - samples.row(j)).squaredNorm();
      if (square > 0.0) squared.push_back(square);
    }
  }
  if (squared.empty()) return 1.0;
  std::nth_element(squared.begin(),
                   squared.begin() + static_cast<std::ptrdiff_t>(squared.size() / 2),
                   squared.end());
  return squared[squared.size() / 2];
}

enum class Kind { kNormal, kDuplicates, kClusters, kTiny, kHuge };

inline core::Matrix Samples(Kind kind, int m, int n, core::Random& random) {
  core::Matrix samples(m, n);
  for (double& x : samples.reshaped()) x = random.Normal();
  for (Eigen::Index i = 0; i < m; ++i) {
    if (kind == Kind::kDuplicates && i % 3 != 0) samples.row(i) = samples.row(i / 3);
    if (kind == Kind::kClusters) samples.row(i).array() += 100.0 * static_cast<double>(i % 4);
  }
  if (kind == Kind::kTiny) samples *= 1e-9;
  if (kind == Kind::kHuge) samples = (1e9 * samples).array() + 1e12;
  return samples;
}

/// Fits `m` samples of `n` entries with each kernel width and each of `nus`, and checks the result.
inline void CheckFits(Kind kind, int m, int n, const std::vector<double>& nus,
                      core::Random& random) {
  constexpr double kTolerance = 1e-3;
  const core::Matrix samples = Samples(kind, m, n, random);
  const double unit = 1.0 / MedianSquaredDistance(samples);
  for (const double width : {1e-6, 1e-3, 0.1, 1.0, 10.0, 1e3, 1e6}) {
    for (const double nu : nus) {
      const double gamma = width * unit;
      SCOPED_TRACE(testing::Message() << m << " x " << n << ", gamma " << width << " / "
                                      << 1.0 / unit << ", nu " << nu);
      // The bound allows for rounding in the second computation of the gap, from its definition.
      FitToTheGap(samples, {.nu = nu, .gamma = gamma, .tolerance = kTolerance},
                  1e-6 * kTolerance + 1e-12 * nu * m);
    }
  }
}

}  // namespace dfr::kernel::test
