#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"
#include "tests/kernel/libsvm_peer.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"

namespace dfr::kernel {
namespace {

using dfr::test::MessageOf;
using test::Decisions;
using test::Tube;
using testing::HasSubstr;

TEST(OneClassSvmWeightsTest, IntegerWeightsActAsRepeatedSamples) {
  core::Random random(44);
  const core::Matrix samples = Tube(300, 3, random);
  std::vector<double> weights(300);
  std::vector<Eigen::Index> repeated;
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    const auto weight = static_cast<int>(random.Below(4));  // some samples have no weight
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
    // The limit is ten times the tolerance divided by nu m, which is at least 90.
    EXPECT_TRUE(dfr::test::AllClose(Decisions(svm, samples), Decisions(expected, samples), 1e-9));
    EXPECT_NEAR(svm.libsvm_scale(), expected.libsvm_scale(), 1e-9 * expected.libsvm_scale());
    for (Eigen::Index i = 0; i < samples.rows(); ++i) {
      const double bound = weights[static_cast<std::size_t>(i)] / svm.libsvm_scale();
      EXPECT_LE(summary.alpha[i], bound * (1.0 + 1e-12));
    }
  }
}

// Two samples too far apart to interact: alpha minimises a^2 + b^2 with a + b = nu (w_a + w_b).
TEST(OneClassSvmWeightsTest, AWeightBoundsAlpha) {
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
  expect(fit({7.0, 1.0}, 0.5), 0.75, 0.25, 0.75);  // 3 and 1; the latter is at its bound
  expect(fit({1.0, 7.0}, 0.5), 0.25, 0.75, 0.75);
  expect(fit({6.0, 2.0}, 1.0), 0.75, 0.25, 0.75);  // both are at their bounds
  // A sample without weight is not a support vector.
  EXPECT_EQ(fit({0.0, 2.0}, 0.5).num_support_vectors(), 1);
  expect(fit({0.0, 2.0}, 0.5), 0.0, 1.0, 1.0);
}

TEST(OneClassSvmWeightsTest, AFitWithWeightsStopsAtItsLimits) {
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

// The gradient of many samples takes seconds.
TEST(OneClassSvmWeightsTest, AFitMayBeStoppedDuringItsFirstGradient) {
  core::Random random(48);
  const Eigen::Index m = 3000;
  const core::Matrix samples = Tube(m, 3, random);
  const std::vector<double> weights(static_cast<std::size_t>(m), 1.0);
  OneClassSvmOptions options{.nu = 0.9, .gamma = 2.0};
  options.weights = weights;
  for (const int call : {1, 2}) {
    int calls = 0;
    options.progress = [&](const FitProgress&) { return ++calls < call; };
    FitSummary summary;
    const auto svm = OneClassSvm::Fit(samples, options, &summary);
    EXPECT_EQ(summary.reason, FitSummary::Reason::kInterrupted);
    EXPECT_EQ(calls, call);
    EXPECT_EQ(summary.iterations, 0);
    EXPECT_LT(summary.kernel_evaluations, m * m / 4);
    EXPECT_EQ(summary.kkt_gap, std::numeric_limits<double>::infinity());
    EXPECT_EQ(summary.objective, std::numeric_limits<double>::infinity());
    // rho is a decision value of the given alpha.
    EXPECT_GT(svm.rho(), 0.0);
    EXPECT_LT(svm.rho(), 1.0);
  }
}

TEST(OneClassSvmWeightsTest, WrongWeightsAreNamed) {
  core::Random random(46);
  const core::Matrix samples = Tube(4, 2, random);
  const auto message = [&](const std::vector<double>& weights, std::span<const double> start) {
    OneClassSvmOptions options;
    options.weights = weights;
    options.start = start;
    return MessageOf<std::invalid_argument>([&] { (void)OneClassSvm::Fit(samples, options); });
  };
  const std::vector<double> start(4, 0.25);
  EXPECT_THAT(message({1.0, 1.0}, {}), HasSubstr("there are 2 weights for 4 samples"));
  EXPECT_THAT(message({1.0, 1.0, -2.0, 1.0}, {}), HasSubstr("the weight of sample 2 is -2"));
  EXPECT_THAT(message({1.0, 1.0, 1.0, std::numeric_limits<double>::infinity()}, {}),
              HasSubstr("the weight of sample 3 is inf"));
  EXPECT_THAT(message({0.0, 0.0, 0.0, 0.0}, {}),
              HasSubstr("the weights must have a positive and finite sum, not 0"));
  EXPECT_THAT(message({1.0, 1.0, 1.0, 1.0}, start), HasSubstr("does not accept a start"));
}

}  // namespace
}  // namespace dfr::kernel
