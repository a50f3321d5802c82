#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"
#include "tests/kernel/libsvm_peer.h"
#include "tests/support/no_alloc.h"

namespace dfr::kernel {
namespace {

using test::Decisions;
using test::Tube;

constexpr double kEndless = std::numeric_limits<double>::infinity();

// A single kernel is steepest at |x| = 1/sqrt(2 gamma).
TEST(OneClassSvmDecisionTest, TheLipschitzBoundIsTheLargestSlopeOfOneKernel) {
  const auto one =
      OneClassSvm::FromParts(core::Matrix::Zero(1, 1), Eigen::VectorXd::Ones(1), 5.0, 0.5);
  const double steepest[] = {1.0 / std::sqrt(10.0)};
  double slope = 0.0;
  one.Gradient(steepest, {&slope, 1});
  EXPECT_NEAR(-slope, one.lipschitz_bound(), 1e-14);
}

TEST(OneClassSvmDecisionTest, BrokenSensorsReadAsOutside) {
  core::Random random(28);
  const auto svm = OneClassSvm::Fit(Tube(50, 3, random), {});
  std::vector<double> gradient(3, 7.0);
  for (const double bad : {std::numeric_limits<double>::quiet_NaN(), kEndless, -kEndless}) {
    const std::vector<double> x = {0.0, bad, 0.0};
    EXPECT_EQ(svm.Decision(x), -kEndless);
    EXPECT_EQ(svm.LogDecision(x), -kEndless);
    EXPECT_EQ(svm.Gradient(x, gradient), -kEndless);
    EXPECT_THAT(gradient, testing::Each(0.0));
    gradient.assign(3, 7.0);
    EXPECT_EQ(svm.LogGradient(x, gradient), -kEndless);
    EXPECT_THAT(gradient, testing::Each(0.0));
  }
  const std::vector<double> wrong_size(4, 0.0);
  EXPECT_EQ(svm.Decision(wrong_size), -kEndless);
  EXPECT_EQ(svm.Decision({}), -kEndless);
  EXPECT_EQ(svm.LogDecision(wrong_size), -kEndless);
  EXPECT_EQ(svm.FromLog(-kEndless), -kEndless);
  const std::vector<double> fine(3, 0.0);
  std::vector<double> long_gradient(4, 7.0);
  EXPECT_EQ(svm.Gradient(wrong_size, long_gradient), -kEndless);
  EXPECT_EQ(svm.LogGradient(wrong_size, long_gradient), -kEndless);
  EXPECT_EQ(svm.Gradient(fine, long_gradient), -kEndless);
  EXPECT_EQ(svm.LogGradient(fine, long_gradient), -kEndless);
  EXPECT_THAT(long_gradient, testing::Each(0.0));
  // Distant but finite: outside the reach of every kernel.
  const std::vector<double> far = {1e300, -1e300, 0.0};
  EXPECT_EQ(svm.Decision(far), -svm.rho());
  EXPECT_EQ(svm.Gradient(far, gradient), -svm.rho());
  EXPECT_THAT(gradient, testing::Each(0.0));
}

TEST(OneClassSvmDecisionTest, DecisionNeverAllocatesAndRepeatsItsBits) {
  core::Random random(29);
  const auto svm = OneClassSvm::Fit(Tube(300, 9, random), {.gamma = 1.0});
  const core::Matrix queries = Tube(50, 9, random);
  const Eigen::VectorXd first = Decisions(svm, queries);
  const OneClassSvm copy = svm;  // NOLINT(performance-unnecessary-copy-initialization)
  std::vector<double> gradient(9);
  const dfr::test::NoAlloc guard;
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    EXPECT_EQ(copy.Decision(core::Row(queries, i)), first[i]);
    svm.Gradient(core::Row(queries, i), gradient);
  }
}

TEST(OneClassSvmDecisionTest, BatchGivesTheBitsOfSingleDecisions) {
  core::Random random(34);
  for (const int n : {1, 9, 200}) {
    const auto in_double = OneClassSvm::Fit(Tube(700, n, random), {.nu = 0.5, .gamma = 1.0 / n});
    const auto in_float = in_double.InSinglePrecision();
    for (const int count : {1, 2, 31, 33, 150}) {
      core::Matrix queries = Tube(count, n, random);
      queries(count / 2, 0) = std::nan("");
      queries(0, n - 1) = 1e200;
      std::vector<double> g(static_cast<std::size_t>(count));
      for (const OneClassSvm* svm : {&in_double, &in_float}) {
        svm->DecisionBatch(queries, g);
        for (int i = 0; i < count; ++i) {
          ASSERT_EQ(g[static_cast<std::size_t>(i)], svm->Decision(core::Row(queries, i)))
              << "query " << i << " of " << count;
        }
      }
    }
  }
}

TEST(OneClassSvmDecisionTest, BatchesGiveTheSameBitsOnAnyNumberOfThreads) {
  core::Random random(56);
  const auto svm = OneClassSvm::Fit(Tube(300, 4, random), {.nu = 0.5, .gamma = 1.0});
  const core::Matrix queries = Tube(5000, 4, random);
  std::vector<double> one(5000), many(5000);
  svm.DecisionBatch(queries, one);
  for (const int threads : {0, 2, 7}) {
    std::fill(many.begin(), many.end(), 0.0);
    svm.DecisionBatch(queries, many, threads);
    EXPECT_EQ(many, one);
  }
  EXPECT_THROW(svm.DecisionBatch(queries, many, -1), std::invalid_argument);
}

TEST(OneClassSvmDecisionTest, SinglePrecisionIsWithinAMillionthOfTheSum) {
  core::Random random(35);
  const auto svm = OneClassSvm::Fit(Tube(400, 9, random), {.nu = 0.3, .gamma = 1.0 / 9.0});
  const auto single = svm.InSinglePrecision();
  const core::Matrix queries = Tube(500, 9, random);
  std::vector<double> a(9), b(9);
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    const auto x = core::Row(queries, i);
    const double sum = svm.Decision(x) + svm.rho();
    EXPECT_NEAR(single.Decision(x), svm.Decision(x), 1e-6 * sum);
    EXPECT_NEAR(single.LogDecision(x), svm.LogDecision(x), 1e-6);
    single.Gradient(x, a);
    svm.Gradient(x, b);
    // Each summand of the gradient is 2 gamma |x - x_i| < 2 times a term of the sum, and so is its
    // error.
    for (std::size_t k = 0; k < 9; ++k) EXPECT_NEAR(a[k], b[k], 2e-6 * sum);
  }
}

// Checks the bound of InSinglePrecision(), which increases with the number of entries.
TEST(OneClassSvmDecisionTest, SinglePrecisionIsWithinItsBoundForManyEntries) {
  core::Random random(50);
  for (const int n : {1, 30, 300, 2048}) {
    const double gamma = 1.0 / n;
    const auto svm = OneClassSvm::Fit(Tube(60, n, random), {.nu = 0.3, .gamma = gamma});
    const auto single = svm.InSinglePrecision();
    const core::Matrix queries = 2.0 * Tube(25, n, random);
    double worst = 0.0;
    for (Eigen::Index i = 0; i < queries.rows(); ++i) {
      const auto x = core::Row(queries, i);
      const double sum = svm.Decision(x) + svm.rho();
      worst = std::max(worst, std::abs(single.Decision(x) - svm.Decision(x)) / sum);
    }
    EXPECT_LE(worst, 1e-6 + 5e-9 * n) << n;
  }
}

// The sum of 600 squares overflows in float although each square is finite.
TEST(OneClassSvmDecisionTest, NoGradientIsNanWhereTheSquaredDistanceOverflows) {
  core::Random random(31);
  for (const int d : {600, OneClassSvm::kMaxStateDim}) {
    const auto fitted = OneClassSvm::Fit(Tube(20, d, random), {.nu = 0.5, .gamma = 1.0});
    const auto svm = fitted.InSinglePrecision();
    const std::vector<double> far(static_cast<std::size_t>(d), 8e17);
    std::vector<double> gradient(far.size(), 7.0);
    EXPECT_EQ(svm.LogDecision(far), -kEndless);
    EXPECT_EQ(svm.LogGradient(far, gradient), -kEndless);
    EXPECT_THAT(gradient, testing::Each(0.0));
    gradient.assign(far.size(), 7.0);
    EXPECT_EQ(svm.Decision(far), -svm.rho());
    EXPECT_EQ(svm.Gradient(far, gradient), -svm.rho());
    EXPECT_THAT(gradient, testing::Each(0.0));
    EXPECT_EQ(fitted.LogGradient(far, gradient), fitted.LogDecision(far));
    EXPECT_LT(fitted.LogDecision(far), -1e30);
    EXPECT_THAT(gradient, testing::Each(testing::Le(0.0)));
  }
}

TEST(OneClassSvmDecisionTest, LogDecisionHasTheSignOfGAndStaysFiniteFarAway) {
  core::Random random(36);
  const auto in_double = OneClassSvm::Fit(Tube(200, 3, random), {.gamma = 5.0});
  const core::Matrix queries = 2.0 * Tube(200, 3, random);
  for (const OneClassSvm& svm : {in_double, in_double.InSinglePrecision()}) {
    for (Eigen::Index i = 0; i < queries.rows(); ++i) {
      const auto x = core::Row(queries, i);
      const double g = svm.Decision(x);
      EXPECT_NEAR(svm.LogDecision(x), std::log((g + svm.rho()) / svm.rho()),
                  1e-12 * svm.rho() / (g + svm.rho()) + 1e-12);
    }
    // Far from the samples all terms underflow: the expected value factors out the largest term.
    // The exponents of the terms are log a_i - gamma |x - x_i|^2.
    const std::vector<double> far = {40.0, -30.0, 20.0};
    double largest = -kEndless;
    double total = 0.0;
    const auto exponent = [&](Eigen::Index i) {
      return std::log(svm.alpha()[i]) -
             5.0 * (svm.support_vectors().row(i).transpose() - core::AsVector(far)).squaredNorm();
    };
    for (Eigen::Index i = 0; i < svm.alpha().size(); ++i) largest = std::max(largest, exponent(i));
    for (Eigen::Index i = 0; i < svm.alpha().size(); ++i) {
      total += std::exp(exponent(i) - largest);
    }
    EXPECT_LT(largest, -10000.0);
    // The tolerance is relative to the exponent, because a float has 24 bits.
    EXPECT_NEAR(svm.LogDecision(far), largest + std::log(total) - std::log(svm.rho()),
                3e-7 * std::abs(largest));
    std::vector<double> gradient(3);
    EXPECT_EQ(svm.LogGradient(far, gradient), svm.LogDecision(far));
    EXPECT_LT(gradient[0], -100.0);  // towards the samples
    EXPECT_GT(gradient[1], 100.0);
  }
}

// States of up to 64 entries use less of the stack than longer states.
TEST(OneClassSvmDecisionTest, ValuesAndGradientsOfLongStatesAgreeWithTheDefinition) {
  constexpr double kGamma = 0.7;
  constexpr double kRho = 0.3;
  for (const int dim : {63, 64, 65, 200}) {
    core::Matrix points = core::Matrix::Zero(2, dim);
    points(1, dim - 1) = 1.0;
    const OneClassSvm svm =
        OneClassSvm::FromParts(points, Eigen::VectorXd::Constant(2, 0.5), kGamma, kRho, 1.0);
    // The sum underflows at the second state.
    for (const double last : {0.4, 60.0}) {
      std::vector<double> x(static_cast<std::size_t>(dim), 0.0);
      x.back() = last;
      const double near = std::exp(-kGamma * (last - 1.0) * (last - 1.0));
      // Ratio of the first point's term to the second point's term.
      const double share = std::exp(-kGamma * (2.0 * last - 1.0));
      const double log_sum = std::log(0.5 * (1.0 + share)) - kGamma * (last - 1.0) * (last - 1.0);
      const double slope = 2.0 * kGamma * (1.0 / (1.0 + share) - last);
      std::vector<double> gradient(x.size(), 1.0);
      EXPECT_NEAR(svm.LogDecision(x), log_sum - std::log(kRho), 1e-9) << dim;
      EXPECT_EQ(svm.LogGradient(x, gradient), svm.LogDecision(x)) << dim;
      EXPECT_NEAR(gradient.back(), slope, 1e-9) << dim;
      EXPECT_EQ(gradient[0], 0.0);
      EXPECT_EQ(svm.Gradient(x, gradient), svm.Decision(x)) << dim;
      EXPECT_NEAR(gradient.back(), 0.5 * near * (1.0 + share) * slope, 1e-12) << dim;
      EXPECT_EQ(gradient[0], 0.0);
    }
  }
}

TEST(OneClassSvmDecisionTest, GradientsAreDerivatives) {
  core::Random random(37);
  const auto svm = OneClassSvm::Fit(Tube(150, 4, random), {.gamma = 2.0});
  const core::Matrix queries = 1.5 * Tube(20, 4, random);
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    std::vector<double> x(core::Row(queries, i).begin(), core::Row(queries, i).end());
    std::vector<double> gradient(4), log_gradient(4);
    EXPECT_EQ(svm.Gradient(x, gradient), svm.Decision(x));
    svm.LogGradient(x, log_gradient);
    constexpr double kStep = 1e-5;
    for (std::size_t k = 0; k < 4; ++k) {
      const double at = x[k];
      x[k] = at + kStep;
      const double ahead = svm.Decision(x);
      const double log_ahead = svm.LogDecision(x);
      x[k] = at - kStep;
      // Truncation h^2 gamma^1.5 and rounding 1e-16 / h are both below 1e-9.
      EXPECT_NEAR(gradient[k], (ahead - svm.Decision(x)) / (2.0 * kStep), 1e-8);
      // The error is the rounding of l, about 1e-15, divided by the step. Truncation is gamma^2
      // h^2.
      EXPECT_NEAR(log_gradient[k], (log_ahead - svm.LogDecision(x)) / (2.0 * kStep), 3e-8);
      x[k] = at;
    }
  }
}

}  // namespace
}  // namespace dfr::kernel
