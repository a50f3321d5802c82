#include "dfr/kernel/one_class_svm.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <ostream>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "gaussian_sum.h"
#include "tests/kernel/libsvm_peer.h"
#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::kernel {
namespace {

using test::LibsvmPeer;
using test::Tube;
using testing::HasSubstr;

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// g of every row.
Eigen::VectorXd Decisions(const OneClassSvm& svm, const core::Matrix& queries) {
  Eigen::VectorXd g(queries.rows());
  for (Eigen::Index i = 0; i < queries.rows(); ++i) g[i] = svm.Decision(core::Row(queries, i));
  return g;
}

// max G over alpha > 0 minus min G over alpha < 1, from the definition, in LIBSVM's scale.
double KktGap(const OneClassSvm& svm, const core::Matrix& samples, double nu) {
  const double bound = 1.0 / (nu * static_cast<double>(samples.rows()));
  double largest = -kInfinity;
  double smallest = kInfinity;
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    double gradient = 0.0;
    double alpha = 0.0;
    for (Eigen::Index j = 0; j < svm.alpha().size(); ++j) {
      const double squared = (samples.row(i) - svm.support_vectors().row(j)).squaredNorm();
      gradient += svm.alpha()[j] * std::exp(-svm.gamma() * squared);
      if (squared == 0.0) alpha = svm.alpha()[j];  // samples are distinct here
    }
    gradient *= svm.libsvm_scale();
    if (alpha > 0.0) largest = std::max(largest, gradient);
    if (alpha < bound * (1.0 - 1e-12)) smallest = std::min(smallest, gradient);
  }
  return largest - smallest;
}

struct Case {
  int m;
  int n;
  double nu;
  double gamma;

  friend std::ostream& operator<<(std::ostream& out, const Case& c) {
    return out << c.m << " x " << c.n << ", nu " << c.nu << ", gamma " << c.gamma;
  }
};

class OneClassSvmPeerTest : public testing::TestWithParam<Case> {};

TEST_P(OneClassSvmPeerTest, DecisionsAndObjectiveAgreeWithLibsvm) {
  const Case c = GetParam();
  core::Random random(21);
  const core::Matrix samples = Tube(c.m, c.n, random);
  const core::Matrix queries = Tube(200, c.n, random);
  const LibsvmPeer peer(samples, c.nu, c.gamma, 1e-8);
  FitSummary summary;
  const auto svm =
      OneClassSvm::Fit(samples, {.nu = c.nu, .gamma = c.gamma, .tolerance = 1e-6}, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);

  Eigen::VectorXd expected(queries.rows());
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    expected[i] = peer.Decision(core::Row(queries, i)) / (c.nu * c.m);
  }
  // 1e-6 of rho, and the rounding of LIBSVM's kernel rows, which are float: half a unit in the last
  // place of values up to 1, weighted by alpha that sum to 1.
  const double tolerance = 1e-6 * svm.rho() + 3e-8;
  EXPECT_TRUE(dfr::test::AllClose(Decisions(svm, queries), expected, tolerance));
  EXPECT_NEAR(svm.rho(), peer.rho() / (c.nu * c.m), tolerance);
  // Both are within about tolerance * nu m of the minimum.
  EXPECT_NEAR(summary.objective, peer.Objective(), 1e-6 * c.nu * c.m + 1e-7 * summary.objective);
}

TEST_P(OneClassSvmPeerTest, KktGapIsBelowTheTolerance) {
  const Case c = GetParam();
  core::Random random(22);
  const core::Matrix samples = Tube(c.m, c.n, random);
  for (const double tolerance : {1e-2, 1e-4, 1e-6}) {
    FitSummary summary;
    const auto svm =
        OneClassSvm::Fit(samples, {.nu = c.nu, .gamma = c.gamma, .tolerance = tolerance}, &summary);
    EXPECT_LT(summary.kkt_gap, tolerance);
    // The definition rounds differently, by about 1e-16 nu m.
    EXPECT_LT(KktGap(svm, samples, c.nu), tolerance + 1e-10);
  }
}

TEST_P(OneClassSvmPeerTest, NuBoundsOutliersFromAboveAndSupportVectorsFromBelow) {
  const Case c = GetParam();
  core::Random random(23);
  const core::Matrix samples = Tube(c.m, c.n, random);
  const auto svm = OneClassSvm::Fit(samples, {.nu = c.nu, .gamma = c.gamma, .tolerance = 1e-6});
  EXPECT_GE(svm.num_support_vectors(), c.nu * c.m - 1e-9);
  // Samples on the boundary have g = 0 up to the tolerance, in our scale.
  const double boundary = 2e-6 / svm.libsvm_scale();
  EXPECT_LE((Decisions(svm, samples).array() < -boundary).count(), c.nu * c.m + 1e-9);
  EXPECT_NEAR(svm.alpha().sum(), 1.0, 1e-12);
  EXPECT_LE(svm.alpha().maxCoeff(), 1.0 / (c.nu * c.m) * (1.0 + 1e-12));
  EXPECT_NEAR(svm.libsvm_scale(), c.nu * c.m, 1e-9 * c.nu * c.m);
}

INSTANTIATE_TEST_SUITE_P(Cases, OneClassSvmPeerTest,
                         testing::Values(Case{120, 12, 0.05, 5.0}, Case{120, 3, 0.5, 1.0},
                                         Case{400, 9, 0.05, 1.0 / 9.0}, Case{400, 2, 0.2, 20.0},
                                         Case{1500, 4, 0.1, 0.25}));

TEST(OneClassSvmTest, LittleMemoryGivesTheSameEstimate) {
  core::Random random(24);
  const core::Matrix samples = Tube(1000, 3, random);
  const core::Matrix queries = Tube(100, 3, random);
  const auto plenty = OneClassSvm::Fit(samples, {.nu = 0.1, .gamma = 2.0, .tolerance = 1e-6});
  FitSummary summary;
  const auto little = OneClassSvm::Fit(
      samples, {.nu = 0.1, .gamma = 2.0, .tolerance = 1e-6, .memory_mib = 1.0}, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
  // Two solutions within the tolerance of each other: 1e-6 over nu m = 100, with a margin of ten.
  EXPECT_TRUE(dfr::test::AllClose(Decisions(little, queries), Decisions(plenty, queries), 1e-7));
}

TEST(OneClassSvmTest, ActiveSetFindsTheSolutionOfTheWholeProblem) {
  core::Random random(40);
  // More samples than are solved at once: nearly all alpha at the bound, and nearly all free.
  const core::Matrix samples = Tube(5000, 3, random);
  for (const double gamma : {0.3, 30.0}) {
    for (const double tolerance : {1e-3, 1e-5}) {  // kernel values in float, and in double
      FitSummary summary;
      const auto svm =
          OneClassSvm::Fit(samples, {.nu = 0.05, .gamma = gamma, .tolerance = tolerance}, &summary);
      EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
      // Kernel values in float shift the gap by up to 1e-7 nu m.
      EXPECT_LT(KktGap(svm, samples, 0.05), tolerance + (tolerance > 1e-4 ? 2.5e-5 : 1e-9));
    }
  }
}

// Kernel values far from the diagonal are zero, and samples that start at the bound are above rho:
// an active set of the samples nearest to moving contains only those that may rise.
TEST(OneClassSvmTest, IsolatedSamplesOfWhichSomeCoincideConverge) {
  core::Random random(47);
  core::Matrix samples(3000, 32);
  for (double& x : samples.reshaped()) x = 10.0 * random.Normal();
  for (Eigen::Index i = 2980; i > 2860; i -= 20) samples.row(i) = samples.row(2860);
  FitSummary summary;
  const auto svm = OneClassSvm::Fit(samples, {.gamma = 5.0, .tolerance = 1e-3}, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
  EXPECT_LT(summary.kkt_gap, 1e-3);
  // K is the identity but for the seven that coincide, which count as one: G = 0.05 * 3000 / 2994.
  EXPECT_NEAR(svm.rho() * svm.libsvm_scale(), 150.0 / 2994.0, 1e-3);
}

// Narrow kernels, whose rows omit negligible values: KKT conditions by the definition, which takes
// about a second.
TEST(OneClassSvmTest, NarrowKernelsFindTheSolutionOfTheWholeProblem) {
  core::Random random(48);
  const core::Matrix samples = 3.0 * Tube(2500, 4, random);
  for (const double gamma : {5.0, 50.0}) {
    for (const double tolerance : {1e-3, 1e-6}) {     // kernel values in float, and in double
      for (const double memory_mib : {512.0, 2.0}) {  // and rows that have to make room
        SCOPED_TRACE(testing::Message() << "gamma " << gamma << ", tolerance " << tolerance << ", "
                                        << memory_mib << " MiB");
        FitSummary summary;
        const auto svm = OneClassSvm::Fit(
            samples, {.nu = 0.05, .gamma = gamma, .tolerance = tolerance, .memory_mib = memory_mib},
            &summary);
        EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
        EXPECT_LT(KktGap(svm, samples, 0.05), tolerance);
      }
    }
  }
}

TEST(OneClassSvmTest, AnyNumberOfThreadsGivesTheSameBits) {
  core::Random random(49);
  const core::Matrix samples = 2.0 * Tube(4200, 5, random);
  for (const double gamma : {0.1, 20.0}) {  // wide and narrow kernels
    for (const double tolerance : {1e-3, 1e-6}) {
      const auto one = OneClassSvm::Fit(samples, {.gamma = gamma, .tolerance = tolerance});
      for (const int threads : {0, 3}) {
        FitSummary summary;
        const auto many = OneClassSvm::Fit(
            samples, {.gamma = gamma, .tolerance = tolerance, .threads = threads}, &summary);
        EXPECT_EQ(many.rho(), one.rho());
        EXPECT_EQ(many.alpha(), one.alpha());
        EXPECT_EQ(many.support_vectors(), one.support_vectors());
      }
    }
  }
  EXPECT_THROW((void)OneClassSvm::Fit(samples, {.threads = -1}), std::invalid_argument);
}

TEST(OneClassSvmTest, AStartLeadsToTheSameEstimateAndTheSolutionItselfAtOnce) {
  core::Random random(41);
  const core::Matrix samples = Tube(800, 3, random);
  OneClassSvmOptions options{.nu = 0.1, .gamma = 2.0, .tolerance = 1e-6};
  FitSummary neighbour, cold, warm;
  (void)OneClassSvm::Fit(samples, {.nu = 0.11, .gamma = 2.1, .tolerance = 1e-6}, &neighbour);
  const auto a = OneClassSvm::Fit(samples, options, &cold);
  options.start = core::AsSpan(std::as_const(neighbour.alpha));
  const auto b = OneClassSvm::Fit(samples, options, &warm);
  // The tolerance over nu m = 80, with a margin of ten.
  EXPECT_TRUE(dfr::test::AllClose(Decisions(b, samples), Decisions(a, samples), 1.3e-7));
  EXPECT_NEAR(warm.alpha.sum(), 1.0, 1e-12);
  options.start = core::AsSpan(std::as_const(cold.alpha));
  (void)OneClassSvm::Fit(samples, options, &warm);
  EXPECT_LT(warm.iterations, cold.iterations / 20);  // scaling alpha and back rounds
}

TEST(OneClassSvmTest, WholeWeightsAreRepeatedSamples) {
  core::Random random(44);
  const core::Matrix samples = Tube(300, 3, random);
  std::vector<double> weights(300);
  std::vector<Eigen::Index> repeated;
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    const auto weight = static_cast<int>(random.Below(4));  // some are left out
    weights[static_cast<std::size_t>(i)] = weight;
    repeated.insert(repeated.end(), static_cast<std::size_t>(weight), i);
  }
  for (const double gamma : {0.3, 20.0}) {
    OneClassSvmOptions options{.nu = 0.2, .gamma = gamma, .tolerance = 1e-8};
    const auto expected = OneClassSvm::Fit(samples(repeated, Eigen::all), options);
    options.weights = weights;
    FitSummary summary;
    const auto svm = OneClassSvm::Fit(samples, options, &summary);
    EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
    EXPECT_LT(summary.kkt_gap, 1e-8);
    // The tolerance over nu m = 90 and more, with a margin of ten.
    EXPECT_TRUE(dfr::test::AllClose(Decisions(svm, samples), Decisions(expected, samples), 1e-9));
    EXPECT_NEAR(svm.libsvm_scale(), expected.libsvm_scale(), 1e-9 * expected.libsvm_scale());
    for (Eigen::Index i = 0; i < samples.rows(); ++i) {
      const double bound = weights[static_cast<std::size_t>(i)] / svm.libsvm_scale();
      EXPECT_LE(summary.alpha[i], bound * (1.0 + 1e-12));
    }
  }
}

TEST(OneClassSvmTest, OnlyTheRatioOfWeightsMatters) {
  core::Random random(45);
  const core::Matrix samples = Tube(200, 2, random);
  OneClassSvmOptions options{.nu = 0.1, .gamma = 1.0, .tolerance = 1e-8};
  const auto expected = OneClassSvm::Fit(samples, options);
  const std::vector<double> weights(200, 2.5);
  options.weights = weights;
  options.tolerance *= 2.5;  // means LIBSVM's scale, which weights stretch
  const auto svm = OneClassSvm::Fit(samples, options);
  // The tolerance over nu m = 20, with a margin of ten.
  EXPECT_TRUE(dfr::test::AllClose(Decisions(svm, samples), Decisions(expected, samples), 5e-9));
  EXPECT_NEAR(svm.libsvm_scale(), 2.5 * expected.libsvm_scale(), 1e-9);
}

// Two samples that do not see each other: alpha minimises a^2 + b^2 with a + b = nu (w_a + w_b).
TEST(OneClassSvmTest, AWeightBoundsAlpha) {
  core::Matrix samples(2, 1);
  samples << 0.0, 100.0;
  const auto fit = [&](const std::vector<double>& weights, double nu) {
    OneClassSvmOptions options{.nu = nu, .gamma = 1.0, .tolerance = 1e-9};
    options.weights = weights;
    return OneClassSvm::Fit(samples, options);
  };
  const auto expect = [&](const OneClassSvm& svm, double a, double b, double rho) {
    EXPECT_NEAR(svm.Decision(core::Row(samples, 0)), a - rho, 1e-9);
    EXPECT_NEAR(svm.Decision(core::Row(samples, 1)), b - rho, 1e-9);
    EXPECT_NEAR(svm.rho(), rho, 1e-9);
  };
  expect(fit({3.0, 3.0}, 0.5), 0.5, 0.5, 0.5);
  expect(fit({7.0, 1.0}, 0.5), 0.75, 0.25, 0.75);  // 3 and 1, which is full
  expect(fit({1.0, 7.0}, 0.5), 0.25, 0.75, 0.75);
  expect(fit({6.0, 2.0}, 1.0), 0.75, 0.25, 0.75);  // both are full
  // No weight, no support vector.
  EXPECT_EQ(fit({0.0, 2.0}, 0.5).num_support_vectors(), 1);
  expect(fit({0.0, 2.0}, 0.5), 0.0, 1.0, 1.0);
}

TEST(OneClassSvmTest, AFitWithWeightsEndsWhereItIsTold) {
  core::Random random(47);
  const core::Matrix samples = Tube(300, 3, random);
  std::vector<double> weights(300);
  for (double& w : weights) w = random.Uniform(0.5, 2.0);
  FitSummary summary;
  OneClassSvmOptions options{.nu = 0.3, .gamma = 2.0};
  options.weights = weights;
  (void)OneClassSvm::Fit(samples, options, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
  EXPECT_LT(summary.kkt_gap, options.tolerance);
  ASSERT_GT(summary.iterations, 20);
  options.max_iterations = 20;
  (void)OneClassSvm::Fit(samples, options, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kMaxIterations);
  EXPECT_EQ(summary.iterations, 20);
  options.max_iterations = 0;
  options.progress = [](const auto&) { return false; };
  (void)OneClassSvm::Fit(samples, options, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kInterrupted);
}

TEST(OneClassSvmTest, WrongWeightsAreNamed) {
  core::Random random(46);
  const core::Matrix samples = Tube(4, 2, random);
  const auto message = [&](const std::vector<double>& weights, std::span<const double> start) {
    OneClassSvmOptions options;
    options.weights = weights;
    options.start = start;
    try {
      (void)OneClassSvm::Fit(samples, options);
    } catch (const std::invalid_argument& e) {
      return std::string(e.what());
    }
    return std::string("nothing thrown");
  };
  const std::vector<double> start(4, 0.25);
  EXPECT_THAT(message({1.0, 1.0}, {}), HasSubstr("there are 2 weights for 4 samples"));
  EXPECT_THAT(message({1.0, 1.0, -2.0, 1.0}, {}), HasSubstr("the weight of sample 2 is -2"));
  EXPECT_THAT(message({1.0, 1.0, 1.0, kInfinity}, {}), HasSubstr("the weight of sample 3 is inf"));
  EXPECT_THAT(message({0.0, 0.0, 0.0, 0.0}, {}),
              HasSubstr("the weights must have a positive and finite sum, not 0"));
  EXPECT_THAT(message({1.0, 1.0, 1.0, 1.0}, start), HasSubstr("cannot be given a start"));
}

TEST(OneClassSvmTest, ProgressIsReportedAndMayStopTheFit) {
  core::Random random(42);
  const core::Matrix samples = Tube(5000, 3, random);
  int calls = 0;
  OneClassSvmOptions options{.gamma = 30.0, .tolerance = 1e-5};
  options.progress = [&](const FitProgress& p) {
    EXPECT_GE(p.iterations, 0);
    EXPECT_GE(p.kkt_gap, 0.0);
    return ++calls < 5;
  };
  FitSummary summary;
  const auto svm = OneClassSvm::Fit(samples, options, &summary);
  EXPECT_EQ(calls, 5);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kInterrupted);
  EXPECT_NEAR(svm.alpha().sum(), 1.0, 1e-12);  // still a valid estimate
}

TEST(OneClassSvmTest, TooLittleMemoryIsRefusedWithTheLeastThatWorks) {
  core::Random random(43);
  const core::Matrix samples = Tube(20000, 8, random);
  try {
    (void)OneClassSvm::Fit(samples, {.memory_mib = 1.0});
    FAIL() << "nothing thrown";
  } catch (const std::invalid_argument& e) {
    EXPECT_THAT(e.what(), HasSubstr("memory_mib of 1 is too little for 20000 x 8 samples"));
  }
}

TEST(OneClassSvmTest, StopsAtTheIterationLimitAndSaysSo) {
  core::Random random(25);
  FitSummary summary;
  const auto svm =
      OneClassSvm::Fit(Tube(200, 3, random), {.tolerance = 1e-9, .max_iterations = 3}, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kMaxIterations);
  EXPECT_EQ(summary.iterations, 3);
  EXPECT_GT(summary.kkt_gap, 1e-9);
  EXPECT_GT(svm.num_support_vectors(), 0);
}

TEST(OneClassSvmTest, GradientIsTheDerivative) {
  core::Random random(26);
  const core::Matrix samples = Tube(150, 5, random);
  const auto svm = OneClassSvm::Fit(samples, {.gamma = 2.0});
  const core::Matrix queries = Tube(20, 5, random);
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    Eigen::VectorXd x = queries.row(i);
    Eigen::VectorXd gradient(5), differences(5);
    EXPECT_EQ(svm.Gradient(core::AsSpan(std::as_const(x)), core::AsSpan(gradient)),
              svm.Decision(core::AsSpan(std::as_const(x))));
    constexpr double kStep = 1e-5;
    for (Eigen::Index k = 0; k < 5; ++k) {
      Eigen::VectorXd y = x;
      y[k] += kStep;
      const double ahead = svm.Decision(core::AsSpan(std::as_const(y)));
      y[k] = x[k] - kStep;
      differences[k] = (ahead - svm.Decision(core::AsSpan(std::as_const(y)))) / (2.0 * kStep);
    }
    // Truncation h^2 gamma^1.5 and rounding 1e-16 / h are both below 1e-9.
    EXPECT_TRUE(dfr::test::AllClose(gradient, differences, 1e-8));
  }
}

TEST(OneClassSvmTest, LipschitzBoundHoldsAndIsTightForOneSample) {
  core::Random random(27);
  const core::Matrix samples = Tube(100, 3, random);
  const auto svm = OneClassSvm::Fit(samples, {.gamma = 5.0});
  std::vector<double> x(3), y(3);
  for (int i = 0; i < 20000; ++i) {
    double squared = 0.0;
    for (std::size_t k = 0; k < 3; ++k) {
      x[k] = random.Uniform(-2.0, 2.0);
      y[k] = x[k] + 0.1 * random.Normal();
      squared += (x[k] - y[k]) * (x[k] - y[k]);
    }
    ASSERT_LE(std::abs(svm.Decision(x) - svm.Decision(y)),
              svm.lipschitz_bound() * std::sqrt(squared) * (1.0 + 1e-12));
  }
  // A single kernel is steepest at |x| = 1/sqrt(2 gamma).
  const auto one =
      OneClassSvm::FromParts(core::Matrix::Zero(1, 1), Eigen::VectorXd::Ones(1), 5.0, 0.5);
  const double steepest[] = {1.0 / std::sqrt(10.0)};
  double slope = 0.0;
  one.Gradient(steepest, {&slope, 1});
  EXPECT_NEAR(-slope, one.lipschitz_bound(), 1e-14);
}

TEST(OneClassSvmTest, BrokenSensorsReadAsOutside) {
  core::Random random(28);
  const auto svm = OneClassSvm::Fit(Tube(50, 3, random), {});
  std::vector<double> gradient(3, 7.0);
  for (const double bad : {std::numeric_limits<double>::quiet_NaN(), kInfinity, -kInfinity}) {
    const std::vector<double> x = {0.0, bad, 0.0};
    EXPECT_EQ(svm.Decision(x), -kInfinity);
    EXPECT_EQ(svm.Gradient(x, gradient), -kInfinity);
    EXPECT_THAT(gradient, testing::Each(0.0));
  }
  const std::vector<double> wrong_size(4, 0.0);
  EXPECT_EQ(svm.Decision(wrong_size), -kInfinity);
  EXPECT_EQ(svm.Decision({}), -kInfinity);
  EXPECT_EQ(svm.LogDecision(wrong_size), -kInfinity);
  EXPECT_EQ(svm.FromLog(-kInfinity), -kInfinity);
  const std::vector<double> fine(3, 0.0);
  std::vector<double> long_gradient(4, 7.0);
  EXPECT_EQ(svm.Gradient(wrong_size, long_gradient), -kInfinity);
  EXPECT_EQ(svm.LogGradient(wrong_size, long_gradient), -kInfinity);
  EXPECT_EQ(svm.Gradient(fine, long_gradient), -kInfinity);
  EXPECT_EQ(svm.LogGradient(fine, long_gradient), -kInfinity);
  EXPECT_THAT(long_gradient, testing::Each(0.0));
  // Far, but finite: no kernel reaches it.
  const std::vector<double> far = {1e300, -1e300, 0.0};
  EXPECT_EQ(svm.Decision(far), -svm.rho());
  EXPECT_EQ(svm.Gradient(far, gradient), -svm.rho());
  EXPECT_THAT(gradient, testing::Each(0.0));
}

TEST(OneClassSvmTest, DecisionNeverAllocatesAndRepeatsItsBits) {
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

TEST(OneClassSvmTest, BatchGivesTheBitsOfSingleDecisions) {
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

TEST(OneClassSvmTest, BatchesGiveTheSameBitsOnAnyNumberOfThreads) {
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

TEST(OneClassSvmTest, SinglePrecisionIsWithinAMillionthOfTheSum) {
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
    // Each summand of the gradient is at most 2 gamma |x - x_i| = 2 of the sum.
    for (std::size_t k = 0; k < 9; ++k) EXPECT_NEAR(a[k], b[k], 2e-6 * sum);
  }
}

// The bound of InSinglePrecision(), which grows with the number of entries.
TEST(OneClassSvmTest, SinglePrecisionIsWithinItsBoundForManyEntries) {
  core::Random random(50);
  for (const int n : {1, 30, 300, 2048}) {
    const double gamma = 1.0 / n;
    const auto svm = OneClassSvm::Fit(Tube(60, n, random), {.nu = 0.3, .gamma = gamma});
    const auto single = svm.InSinglePrecision();
    const core::Matrix queries = 2.0 * Tube(100, n, random);
    double worst = 0.0;
    for (Eigen::Index i = 0; i < queries.rows(); ++i) {
      const auto x = core::Row(queries, i);
      const double sum = svm.Decision(x) + svm.rho();
      worst = std::max(worst, std::abs(single.Decision(x) - svm.Decision(x)) / sum);
    }
    EXPECT_LE(worst, 1e-6 + 5e-9 * n) << n;
  }
}

TEST(OneClassSvmTest, LogDecisionHasTheSignOfGAndReachesFar) {
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
    // Far away one term remains: l = log a_i - gamma |x - x_i|^2 - log rho, by definition.
    const std::vector<double> far = {40.0, -30.0, 20.0};
    double largest = -kInfinity;
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
    // Relative to the exponent: float has 24 bits.
    EXPECT_NEAR(svm.LogDecision(far), largest + std::log(total) - std::log(svm.rho()),
                3e-7 * std::abs(largest));
    std::vector<double> gradient(3);
    EXPECT_EQ(svm.LogGradient(far, gradient), svm.LogDecision(far));
    EXPECT_LT(gradient[0], -100.0);  // towards the samples
    EXPECT_GT(gradient[1], 100.0);
    const std::vector<double> broken = {0.0, std::nan(""), 0.0};
    EXPECT_EQ(svm.LogDecision(broken), -kInfinity);
    EXPECT_EQ(svm.LogGradient(broken, gradient), -kInfinity);
    EXPECT_THAT(gradient, testing::Each(0.0));
  }
}

// States of up to 64 entries use a smaller part of the stack than longer ones.
TEST(OneClassSvmTest, ValuesAndGradientsAreThoseOfTheDefinitionForLongStates) {
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
      const double share = std::exp(-kGamma * (2.0 * last - 1.0));  // of the first point's term
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

TEST(OneClassSvmTest, LogGradientIsTheDerivativeOfLogDecision) {
  core::Random random(37);
  const auto svm = OneClassSvm::Fit(Tube(150, 4, random), {.gamma = 2.0});
  const core::Matrix queries = 1.5 * Tube(20, 4, random);
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    std::vector<double> x(core::Row(queries, i).begin(), core::Row(queries, i).end());
    std::vector<double> gradient(4);
    svm.LogGradient(x, gradient);
    constexpr double kStep = 1e-5;
    for (std::size_t k = 0; k < 4; ++k) {
      const double at = x[k];
      x[k] = at + kStep;
      const double ahead = svm.LogDecision(x);
      x[k] = at - kStep;
      // Rounding of l, about 1e-15, over the step; truncation is gamma^2 h^2.
      EXPECT_NEAR(gradient[k], (ahead - svm.LogDecision(x)) / (2.0 * kStep), 3e-8);
      x[k] = at;
    }
  }
}

// The ball of core::LogDecisionFunction::curvature_bound() at x, with c = gamma.
struct Ball {
  std::vector<double> shift;  // of the centre, from x
  double radius = 0.0;        // NaN: there is none
  double worst = 0.0;         // largest allowed change of state

  Ball(const OneClassSvm& svm, std::span<const double> x) : shift(x.size()) {
    const double l = svm.LogGradient(x, shift);
    double square = 0.0;
    for (double& entry : shift) {
      entry /= 2.0 * svm.gamma();
      square += entry * entry;
    }
    radius = std::sqrt(square + l / svm.gamma());
    worst = radius - std::sqrt(square);
  }
};

// The bound is a proof: no state of the ball is outside, and the ball is larger than g / L.
TEST(OneClassSvmTest, NoStateOfTheBallOfTheCurvatureBoundIsOutside) {
  core::Random random(38);
  const core::Matrix samples = Tube(150, 3, random);
  const auto svm = OneClassSvm::Fit(samples, {.nu = 0.1, .gamma = 2.0});
  std::vector<double> y(3), direction(3);
  int inside = 0;
  double radius_sum = 0.0;
  double lipschitz_sum = 0.0;
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    const auto x = core::Row(samples, i);
    const Ball ball(svm, x);
    if (svm.Decision(x) < 0.0) {
      EXPECT_FALSE(ball.worst >= 0.0);
      continue;
    }
    ++inside;
    EXPECT_GE(ball.worst, 0.0);
    radius_sum += ball.worst;
    lipschitz_sum += svm.Decision(x) / svm.lipschitz_bound();
    for (int trial = 0; trial < 100; ++trial) {
      random.Direction(direction);
      for (std::size_t k = 0; k < 3; ++k) {
        y[k] = x[k] + ball.shift[k] + ball.radius * direction[k];
      }
      EXPECT_GE(svm.Decision(y), -1e-14);
    }
  }
  EXPECT_GT(inside, 100);
  EXPECT_GT(radius_sum, 1.5 * lipschitz_sum);
}

// One kernel: the support is a ball, which the bound finds exactly wherever one stands.
TEST(OneClassSvmTest, TheBallOfOneKernelIsItsSupport) {
  const auto one =
      OneClassSvm::FromParts(core::Matrix::Zero(1, 1), Eigen::VectorXd::Ones(1), 2.0, 0.5);
  const double true_radius = std::sqrt(std::log(2.0) / 2.0);
  for (const double x : {0.0, 0.3, 5.0, 300.0}) {
    const Ball ball(one, {&x, 1});
    EXPECT_NEAR(x + ball.shift[0], 0.0, 1e-13 * x);
    EXPECT_NEAR(ball.radius, true_radius, 1e-10);  // cancels 2 * 300^2 in l
  }
}

TEST(OneClassSvmTest, ErrorsNameTheCulprit) {
  const auto message = [](const std::function<void()>& call) -> std::string {
    try {
      call();
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  const core::Matrix fine = core::Matrix::Random(10, 2);
  const auto fit = [&](const core::Matrix& samples, OneClassSvmOptions options) {
    return message([&] { (void)OneClassSvm::Fit(samples, options); });
  };
  EXPECT_THAT(fit(fine, {.nu = 0.0}), HasSubstr("nu must lie in (0, 1], not 0"));
  EXPECT_THAT(fit(fine, {.nu = 1.1}), HasSubstr("nu must lie in (0, 1], not 1.1"));
  EXPECT_THAT(fit(fine, {.nu = std::nan("")}), HasSubstr("nu must"));
  EXPECT_THAT(fit(fine, {.gamma = -1.0}), HasSubstr("gamma must be positive"));
  EXPECT_THAT(fit(fine, {.gamma = kInfinity}), HasSubstr("gamma must be positive and finite"));
  EXPECT_THAT(fit(fine, {.tolerance = 0.0}), HasSubstr("tolerance must be positive"));
  EXPECT_THAT(fit(fine, {.max_iterations = -1}), HasSubstr("max_iterations"));
  EXPECT_THAT(fit(fine, {.memory_mib = 0.0}), HasSubstr("memory_mib"));
  const std::vector<double> few(3, 1.0), negative(10, -1.0), none(10, 0.0);
  EXPECT_THAT(fit(fine, {.start = few}), HasSubstr("3 alpha for 10 samples"));
  EXPECT_THAT(fit(fine, {.start = negative}), HasSubstr("not negative: -1"));
  EXPECT_THAT(fit(fine, {.start = none}), HasSubstr("sum, not 0"));
  EXPECT_THAT(fit(core::Matrix(1, 2), {}), HasSubstr("at least 2 samples; there are 1"));
  EXPECT_THAT(fit(core::Matrix(5, 0), {}), HasSubstr("1 to 2048 entries, not 0"));
  core::Matrix broken = fine;
  broken(7, 1) = std::nan("");
  EXPECT_THAT(fit(broken, {}), HasSubstr("sample 7, entry 1 is nan"));
  const std::vector<double> endless(10, kInfinity);
  EXPECT_THAT(fit(fine, {.start = endless}), HasSubstr("not negative: inf"));
  EXPECT_THAT(fit(fine, {.tolerance = kInfinity}), HasSubstr("tolerance must be positive"));
  EXPECT_THAT(fit(core::Matrix::Zero(5, 2049), {}), HasSubstr("1 to 2048 entries, not 2049"));
  const auto parts = [&](const core::Matrix& vectors, const Eigen::VectorXd& alpha, double gamma,
                         double rho, double scale) {
    return message([&] { (void)OneClassSvm::FromParts(vectors, alpha, gamma, rho, scale); });
  };
  const core::Matrix vectors = core::Matrix::Zero(2, 1);
  const Eigen::Vector2d half(0.5, 0.5);
  EXPECT_THAT(parts(vectors, half, 1.0, 0.0, 1.0), HasSubstr("nothing thrown"));
  EXPECT_THAT(parts(core::Matrix::Zero(2, 2048), half, 1.0, 0.0, 1.0), HasSubstr("nothing thrown"));
  EXPECT_THAT(parts(core::Matrix::Zero(2, 2049), half, 1.0, 0.0, 1.0), HasSubstr("not 2049"));
  EXPECT_THAT(parts(core::Matrix(0, 1), half, 1.0, 0.0, 1.0), HasSubstr("no support vector"));
  EXPECT_THAT(parts(core::Matrix(2, 0), half, 1.0, 0.0, 1.0), HasSubstr("entries, not 0"));
  EXPECT_THAT(parts(core::Matrix::Zero(3, 1), half, 1.0, 0.0, 1.0), HasSubstr("2 alpha for 3"));
  EXPECT_THAT(parts(broken, Eigen::VectorXd::Constant(10, 0.1), 1.0, 0.0, 1.0),
              HasSubstr("a support vector is not finite"));
  EXPECT_THAT(parts(vectors, Eigen::Vector2d::Ones(), 1.0, 0.0, 1.0),
              HasSubstr("alpha must sum to 1, not 2"));
  EXPECT_THAT(parts(vectors, Eigen::Vector2d(0.0, 1.0), 1.0, 0.0, 1.0),
              HasSubstr("alpha must be positive"));
  for (const double bad : {0.0, kInfinity}) {
    EXPECT_THAT(parts(vectors, half, bad, 0.0, 1.0), HasSubstr("gamma must be positive"));
    EXPECT_THAT(parts(vectors, half, 1.0, 0.0, bad), HasSubstr("libsvm_scale must be positive"));
  }
  EXPECT_THAT(parts(vectors, half, 1.0, std::nan(""), 1.0), HasSubstr("rho must be finite"));
}

// Problems without a unique alpha or without free support vectors: the estimate is still defined.
TEST(OneClassSvmTest, OneDistinctPointIsItsOwnSupport) {
  const core::Matrix samples = core::Matrix::Constant(40, 3, 0.7);
  for (const double nu : {0.01, 0.3, 1.0}) {
    const auto svm = OneClassSvm::Fit(samples, {.nu = nu, .gamma = 2.0});
    const std::vector<double> same(3, 0.7);
    const std::vector<double> other(3, 0.8);
    EXPECT_NEAR(svm.Decision(same), 0.0, 1e-12);
    EXPECT_LT(svm.Decision(other), -0.01);
  }
}

TEST(OneClassSvmTest, DuplicatedSamplesGiveTheEstimateOfTheDistinctOnes) {
  core::Random random(30);
  const core::Matrix once = Tube(60, 3, random);
  const core::Matrix thrice = once.replicate(3, 1);
  const core::Matrix queries = Tube(50, 3, random);
  const auto a = OneClassSvm::Fit(once, {.nu = 0.2, .gamma = 3.0, .tolerance = 1e-7});
  const auto b = OneClassSvm::Fit(thrice, {.nu = 0.2, .gamma = 3.0, .tolerance = 1e-7});
  // The tolerance over nu m = 12, with a margin of ten.
  EXPECT_TRUE(dfr::test::AllClose(Decisions(b, queries), Decisions(a, queries), 1e-7));
}

TEST(OneClassSvmTest, NuOfOneIsTheParzenDensity) {
  core::Random random(31);
  const core::Matrix samples = Tube(50, 2, random);
  const auto svm = OneClassSvm::Fit(samples, {.nu = 1.0, .gamma = 1.0});
  EXPECT_EQ(svm.num_support_vectors(), 50);
  EXPECT_TRUE(dfr::test::AllClose(svm.alpha(), Eigen::VectorXd::Constant(50, 0.02), 1e-15));
  // The densest sample lies on the boundary, all others outside.
  EXPECT_NEAR(Decisions(svm, samples).maxCoeff(), 0.0, 1e-12);
}

TEST(OneClassSvmTest, NuNearBothEndsConverges) {
  core::Random random(44);
  const core::Matrix samples = Tube(300, 3, random);
  for (const double tolerance : {1e-3, 1e-7}) {  // kernel values in float, and in double
    for (const double nu : {1e-12, 1e-4, 1.0 / 300.0, 0.999, 1.0 - 1e-12}) {
      SCOPED_TRACE(testing::Message() << "nu = " << nu << ", tolerance " << tolerance);
      FitSummary summary;
      const auto svm =
          OneClassSvm::Fit(samples, {.nu = nu, .gamma = 1.0, .tolerance = tolerance}, &summary);
      EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
      EXPECT_NEAR(svm.alpha().sum(), 1.0, 1e-12);
      EXPECT_GE(svm.num_support_vectors(), nu * 300.0 - 1e-6);
      // Outliers, beyond the tolerance in our scale.
      EXPECT_LE((Decisions(svm, samples).array() < -2.0 * tolerance / svm.libsvm_scale()).count(),
                nu * 300.0 + 1e-6);
      EXPECT_TRUE(std::isfinite(svm.rho()));
    }
  }
}

// With samples that nearly coincide: their kernel value rounds to 1, or above it.
TEST(OneClassSvmTest, EveryInstructionSetFindsTheSolution) {
  core::Random random(46);
  core::Matrix few = Tube(600, 3, random);
  core::Matrix many = Tube(2200, 3, random);
  for (core::Matrix* samples : {&few, &many}) {
    const Eigen::Index half = samples->rows() / 2;
    samples->bottomRows(half) = samples->topRows(half);
    for (Eigen::Index i = 0; i < half; ++i) (*samples)(i, 0) += 1e-4 * random.Normal();
    for (const std::int64_t target : internal::SupportedTargets()) {
      internal::ForceTarget(target);
      for (const double tolerance : {1e-3, 1e-6}) {  // kernel values in float, and in double
        SCOPED_TRACE(testing::Message() << internal::TargetName(target) << ", " << samples->rows()
                                        << " samples, tolerance " << tolerance);
        FitSummary summary;
        const auto svm =
            OneClassSvm::Fit(*samples, {.nu = 0.1, .gamma = 5.0, .tolerance = tolerance}, &summary);
        EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
        // Kernel values in float shift the gap by up to 1e-7 nu m.
        EXPECT_LT(KktGap(svm, *samples, 0.1), tolerance + (tolerance > 1e-4 ? 3e-5 : 1e-9));
      }
    }
    internal::ForceTarget(0);
  }
}

// Two samples, and a few more than fill a vector of lanes: the least that there is to choose from.
TEST(OneClassSvmTest, TheSmallestProblemsConverge) {
  core::Random random(45);
  for (const int m : {2, 3, 15, 16, 17, 33}) {
    const core::Matrix samples = Tube(m, 2, random);
    for (const double tolerance : {1e-3, 1e-8}) {
      FitSummary summary;
      const auto svm =
          OneClassSvm::Fit(samples, {.nu = 0.5, .gamma = 1.0, .tolerance = tolerance}, &summary);
      EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged) << m;
      EXPECT_LT(KktGap(svm, samples, 0.5), tolerance + 1e-10) << m;
    }
  }
}

TEST(OneClassSvmTest, FewerSamplesThanOneOverNuContainAllOfThem) {
  core::Random random(32);
  const core::Matrix samples = Tube(10, 2, random);
  const auto svm = OneClassSvm::Fit(samples, {.nu = 0.01, .gamma = 1.0, .tolerance = 1e-7});
  EXPECT_GE(Decisions(svm, samples).minCoeff(), -1e-5);  // the tolerance over nu m = 0.1
}

TEST(OneClassSvmTest, ConstantFeaturesChangeNothing) {
  core::Random random(33);
  const core::Matrix samples = Tube(80, 2, random);
  core::Matrix wide(80, 3);
  wide << samples, Eigen::VectorXd::Constant(80, -4.0);
  const auto a = OneClassSvm::Fit(samples, {.gamma = 1.0, .tolerance = 1e-7});
  const auto b = OneClassSvm::Fit(wide, {.gamma = 1.0, .tolerance = 1e-7});
  // The tolerance over nu m = 4, with a margin of ten.
  EXPECT_TRUE(dfr::test::AllClose(Decisions(b, wide), Decisions(a, samples), 3e-7));
}

}  // namespace
}  // namespace dfr::kernel
