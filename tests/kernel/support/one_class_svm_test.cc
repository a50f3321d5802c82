#include "dfr/kernel/one_class_svm.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <ostream>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "dfr/core/random.h"
#include "gaussian/gaussian_sum.h"
#include "tests/kernel/libsvm_peer.h"
#include "tests/kernel/smo/hard_problems.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"

namespace dfr::kernel {
namespace {

using dfr::test::MessageOf;
using test::Decisions;
using test::FitToTheGap;
using test::LibsvmPeer;
using test::Tube;
using testing::HasSubstr;

constexpr double kUnbounded = std::numeric_limits<double>::infinity();

struct Case {
  int m;
  int n;
  double nu;
  double gamma;

  friend std::ostream& operator<<(std::ostream& out, const Case& c) {
    return out << c.m << " x " << c.n << ", nu " << c.nu << ", gamma " << c.gamma;
  }
};

// At most a share nu of the samples is outside, and at least that share are support vectors.
void ExpectNuHolds(const OneClassSvm& svm, const core::Matrix& samples, double nu,
                   double tolerance) {
  const double share = nu * static_cast<double>(samples.rows());
  EXPECT_GE(svm.num_support_vectors(), share - 1e-9);
  // Samples on the boundary have g = 0 up to the tolerance, in our scale.
  const double boundary = 2.0 * tolerance / svm.libsvm_scale();
  EXPECT_LE((Decisions(svm, samples).array() < -boundary).count(), share + 1e-9);
}

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
  // Both objectives are within about tolerance * nu m of the minimum.
  EXPECT_NEAR(summary.objective, peer.Objective(), 1e-6 * c.nu * c.m + 1e-7 * summary.objective);
}

TEST_P(OneClassSvmPeerTest, TheKktGapAndThePropertiesOfNuHold) {
  const Case c = GetParam();
  core::Random random(22);
  const core::Matrix samples = Tube(c.m, c.n, random);
  for (const double tolerance : {1e-2, 1e-4, 1e-6}) {
    // The definition rounds differently, by about 1e-16 nu m.
    const auto svm =
        FitToTheGap(samples, {.nu = c.nu, .gamma = c.gamma, .tolerance = tolerance}, 1e-10);
    ExpectNuHolds(svm, samples, c.nu, tolerance);
    EXPECT_LE(svm.alpha().maxCoeff(), 1.0 / (c.nu * c.m) * (1.0 + 1e-12));
    EXPECT_NEAR(svm.libsvm_scale(), c.nu * c.m, 1e-9 * c.nu * c.m);
  }
}

INSTANTIATE_TEST_SUITE_P(Cases, OneClassSvmPeerTest,
                         testing::Values(Case{120, 12, 0.05, 5.0}, Case{120, 3, 0.5, 1.0},
                                         Case{400, 9, 0.05, 1.0 / 9.0}, Case{400, 2, 0.2, 20.0},
                                         Case{1500, 4, 0.1, 0.25}));

TEST(OneClassSvmTest, LittleMemoryFindsTheSolution) {
  core::Random random(24);
  FitToTheGap(Tube(1000, 3, random),
              {.nu = 0.1, .gamma = 2.0, .tolerance = 1e-6, .memory_mib = 1.0}, 1e-9);
}

TEST(OneClassSvmTest, ActiveSetFindsTheSolutionOfTheWholeProblem) {
  core::Random random(40);
  // More samples than the solver handles at once. Nearly all alpha are at the bound, or nearly all
  // are free.
  const core::Matrix samples = Tube(5000, 3, random);
  for (const double gamma : {0.3, 30.0}) {
    // The first fit has kernel values in float, which shift the gap by up to 1e-7 nu m. The second
    // fit has kernel values in double.
    FitToTheGap(samples, {.nu = 0.05, .gamma = gamma, .tolerance = 1e-3}, 2.5e-5);
    FitToTheGap(samples, {.nu = 0.05, .gamma = gamma, .tolerance = 1e-5}, 1e-9);
  }
}

// Kernel values of distinct samples are zero, and samples that start at the bound are above rho:
// an active set of only the samples nearest to their KKT condition would have only alpha that may
// rise.
TEST(OneClassSvmTest, IsolatedSamplesWithDuplicatesConverge) {
  core::Random random(47);
  core::Matrix samples(3000, 32);
  for (double& x : samples.reshaped()) x = 10.0 * random.Normal();
  for (Eigen::Index i = 2980; i > 2860; i -= 20) samples.row(i) = samples.row(2860);
  FitSummary summary;
  const auto svm = OneClassSvm::Fit(samples, {.gamma = 5.0, .tolerance = 1e-3}, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
  EXPECT_LT(summary.kkt_gap, 1e-3);
  // K is the identity except for the seven equal samples, which count as one sample: G = 0.05 *
  // 3000 / 2994.
  EXPECT_NEAR(svm.rho() * svm.libsvm_scale(), 150.0 / 2994.0, 1e-3);
}

// The rows of narrow kernels omit negligible values. The KKT gap is computed from the definition.
TEST(OneClassSvmTest, NarrowKernelsFindTheSolutionOfTheWholeProblem) {
  core::Random random(48);
  const core::Matrix samples = 3.0 * Tube(2100, 4, random);
  // The cases have kernel values in float and in double, and rows that must be evicted.
  for (const auto& [gamma, tolerance, memory_mib] :
       {std::tuple(5.0, 1e-3, 512.0), std::tuple(5.0, 1e-6, 2.0), std::tuple(50.0, 1e-3, 2.0),
        std::tuple(50.0, 1e-6, 512.0)}) {
    SCOPED_TRACE(testing::Message() << "gamma " << gamma << ", tolerance " << tolerance << ", "
                                    << memory_mib << " MiB");
    FitToTheGap(samples,
                {.nu = 0.05, .gamma = gamma, .tolerance = tolerance, .memory_mib = memory_mib},
                0.0);
  }
}

TEST(OneClassSvmTest, AnyNumberOfThreadsGivesTheSameBits) {
  core::Random random(49);
  const core::Matrix samples = 2.0 * Tube(4200, 5, random);
  // The cases are wide and narrow kernels in float and in double, and many samples at the bound.
  for (const auto& [nu, gamma, tolerance] :
       {std::tuple(0.05, 0.1, 1e-3), std::tuple(0.05, 0.1, 1e-6), std::tuple(0.05, 20.0, 1e-3),
        std::tuple(0.05, 20.0, 1e-6), std::tuple(0.7, 0.3, 1e-3)}) {
    OneClassSvmOptions options{.nu = nu, .gamma = gamma, .tolerance = tolerance};
    const auto one = OneClassSvm::Fit(samples, options);
    options.threads = 3;
    const auto many = OneClassSvm::Fit(samples, options);
    EXPECT_EQ(many.rho(), one.rho());
    EXPECT_EQ(many.alpha(), one.alpha());
    EXPECT_EQ(many.support_vectors(), one.support_vectors());
  }
  EXPECT_THROW((void)OneClassSvm::Fit(samples, {.threads = -1}), std::invalid_argument);
}

TEST(OneClassSvmTest, AStartKeepsTheEstimateAndTheSolutionEndsAtOnce) {
  core::Random random(41);
  const core::Matrix samples = Tube(800, 3, random);
  OneClassSvmOptions options{.nu = 0.1, .gamma = 2.0, .tolerance = 1e-6};
  FitSummary neighbour, cold, warm;
  (void)OneClassSvm::Fit(samples, {.nu = 0.11, .gamma = 2.1, .tolerance = 1e-6}, &neighbour);
  const auto a = OneClassSvm::Fit(samples, options, &cold);
  options.start = core::AsSpan(std::as_const(neighbour.alpha));
  const auto b = OneClassSvm::Fit(samples, options, &warm);
  // The limit is ten times the tolerance divided by nu m = 80.
  EXPECT_TRUE(dfr::test::AllClose(Decisions(b, samples), Decisions(a, samples), 1.3e-7));
  EXPECT_NEAR(warm.alpha.sum(), 1.0, 1e-12);
  options.start = core::AsSpan(std::as_const(cold.alpha));
  (void)OneClassSvm::Fit(samples, options, &warm);
  EXPECT_LT(warm.iterations, cold.iterations / 20);  // converting alpha to LIBSVM's scale rounds it
}

// Fits of one thread share memory. The inner fit runs in the outer fit's progress call.
TEST(OneClassSvmTest, AFitWithinProgressChangesNoBitOfTheOuterFit) {
  core::Random random(44);
  const core::Matrix outer = Tube(120, 5, random);
  const core::Matrix inner = Tube(90, 3, random);
  FitSummary alone;
  const auto expected = OneClassSvm::Fit(outer, {}, &alone);
  int calls = 0;
  OneClassSvmOptions options;
  options.progress = [&](const FitProgress&) {
    ++calls;
    (void)OneClassSvm::Fit(inner, {});
    return true;
  };
  FitSummary summary;
  const auto svm = OneClassSvm::Fit(outer, options, &summary);
  EXPECT_GE(calls, 1);
  EXPECT_EQ(summary.alpha, alone.alpha);
  EXPECT_EQ(svm.rho(), expected.rho());
}

TEST(OneClassSvmTest, TooLittleMemoryIsRefusedWithTheLeastThatWorks) {
  const core::Matrix samples = core::Matrix::Zero(20000, 8);
  EXPECT_THAT(MessageOf<std::invalid_argument>(
                  [&] { (void)OneClassSvm::Fit(samples, {.memory_mib = 1.0}); }),
              HasSubstr("memory_mib of 1 is too little for 20000 x 8 samples: set it to at least"));
}

// The gap of a fit in float is too large here. A fit in double needs more than 4 MiB.
TEST(OneClassSvmTest, AFitInFloatIsKeptIfDoublesNeedMoreMemory) {
  core::Random random(24);
  const Eigen::Index m = 5000;
  core::Matrix samples = Tube(m, 64, random);
  samples.array() += 1000.0;
  OneClassSvmOptions options{.nu = 0.05, .gamma = 0.01, .tolerance = 5.25e-6};
  FitSummary summary;
  const auto precise = OneClassSvm::Fit(samples, options, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
  options.memory_mib = 4.0;
  const auto svm = OneClassSvm::Fit(samples, options, &summary);
  EXPECT_EQ(summary.reason, FitSummary::Reason::kStalled);
  EXPECT_GE(summary.kkt_gap, options.tolerance);
  EXPECT_LT(summary.kkt_gap, 100.0 * options.tolerance);
  EXPECT_NEAR(svm.rho(), precise.rho(), summary.kkt_gap / svm.libsvm_scale());
  options.tolerance = 1e-9;
  EXPECT_THAT(
      MessageOf<std::invalid_argument>([&] { (void)OneClassSvm::Fit(samples, options); }),
      HasSubstr("memory_mib of 4 is too little for 5000 x 64 samples: set it to at least 6"));
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

TEST(OneClassSvmTest, ErrorsNameTheCulprit) {
  const core::Matrix fine = core::Matrix::Random(10, 2);
  const auto fit = [&](const core::Matrix& samples, OneClassSvmOptions options) {
    return MessageOf<std::invalid_argument>([&] { (void)OneClassSvm::Fit(samples, options); });
  };
  EXPECT_THAT(fit(fine, {.nu = 0.0}), HasSubstr("nu must lie in (0, 1], not 0"));
  EXPECT_THAT(fit(fine, {.nu = 1.1}), HasSubstr("nu must lie in (0, 1], not 1.1"));
  EXPECT_THAT(fit(fine, {.nu = std::nan("")}), HasSubstr("nu must"));
  EXPECT_THAT(fit(fine, {.gamma = -1.0}), HasSubstr("gamma must be positive"));
  EXPECT_THAT(fit(fine, {.gamma = kUnbounded}), HasSubstr("gamma must be positive and finite"));
  EXPECT_THAT(fit(fine, {.tolerance = 0.0}), HasSubstr("tolerance must be positive"));
  EXPECT_THAT(fit(fine, {.max_iterations = -1}), HasSubstr("max_iterations"));
  EXPECT_THAT(fit(fine, {.memory_mib = 0.0}), HasSubstr("memory_mib"));
  const std::vector<double> few(3, 1.0), negative(10, -1.0), none(10, 0.0);
  EXPECT_THAT(fit(fine, {.start = few}), HasSubstr("3 values of alpha for 10 samples"));
  EXPECT_THAT(fit(fine, {.start = negative}), HasSubstr("not negative: -1"));
  EXPECT_THAT(fit(fine, {.start = none}), HasSubstr("sum, not 0"));
  EXPECT_THAT(fit(core::Matrix(1, 2), {}), HasSubstr("at least 2 samples; there are 1"));
  EXPECT_THAT(fit(core::Matrix(5, 0), {}), HasSubstr("1 to 2048 entries, not 0"));
  core::Matrix broken = fine;
  broken(7, 1) = std::nan("");
  EXPECT_THAT(fit(broken, {}), HasSubstr("sample 7, entry 1 is nan"));
  const std::vector<double> endless(10, kUnbounded);
  EXPECT_THAT(fit(fine, {.start = endless}), HasSubstr("not negative: inf"));
  EXPECT_THAT(fit(fine, {.tolerance = kUnbounded}), HasSubstr("tolerance must be positive"));
  EXPECT_THAT(fit(core::Matrix::Zero(5, 2049), {}), HasSubstr("1 to 2048 entries, not 2049"));
  const auto parts = [&](const core::Matrix& vectors, const Eigen::VectorXd& alpha, double gamma,
                         double rho, double scale) {
    return MessageOf<std::invalid_argument>(
        [&] { (void)OneClassSvm::FromParts(vectors, alpha, gamma, rho, scale); });
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
  for (const double bad : {0.0, kUnbounded}) {
    EXPECT_THAT(parts(vectors, half, bad, 0.0, 1.0), HasSubstr("gamma must be positive"));
    EXPECT_THAT(parts(vectors, half, 1.0, 0.0, bad), HasSubstr("libsvm_scale must be positive"));
  }
  EXPECT_THAT(parts(vectors, half, 1.0, std::nan(""), 1.0), HasSubstr("rho must be finite"));
}

// Problems without a unique alpha or without free support vectors still have a defined estimate.
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

TEST(OneClassSvmTest, NuOfOneIsTheParzenDensity) {
  core::Random random(31);
  const core::Matrix samples = Tube(50, 2, random);
  const auto svm = OneClassSvm::Fit(samples, {.nu = 1.0, .gamma = 1.0});
  EXPECT_EQ(svm.num_support_vectors(), 50);
  EXPECT_TRUE(dfr::test::AllClose(svm.alpha(), Eigen::VectorXd::Constant(50, 0.02), 1e-15));
  // The densest sample lies on the boundary, all others outside.
  EXPECT_NEAR(Decisions(svm, samples).maxCoeff(), 0.0, 1e-12);
}

// Below 1/m the bound of alpha exceeds its sum: every smaller nu has the same solution.
TEST(OneClassSvmTest, NuBelowOneSampleIsNuOfOneSample) {
  core::Random random(45);
  const core::Matrix samples = Tube(200, 3, random);
  const std::vector<double> weights(200, 0.25);
  for (const bool weighted : {false, true}) {
    OneClassSvmOptions options{.nu = 1.0 / 200.0, .gamma = 0.5};
    if (weighted) options.weights = weights;
    const OneClassSvm one = OneClassSvm::Fit(samples, options);
    for (const double nu : {1e-3, 1e-6, 1e-12, 1e-200, 1e-320}) {
      SCOPED_TRACE(nu);
      options.nu = nu;
      FitSummary summary;
      const OneClassSvm svm = OneClassSvm::Fit(samples, options, &summary);
      EXPECT_EQ(svm.rho(), one.rho());
      EXPECT_EQ(svm.alpha(), one.alpha());
      EXPECT_NEAR(svm.libsvm_scale(), nu * (weighted ? 50.0 : 200.0), 1e-12 * nu);
      EXPECT_EQ(summary.reason, FitSummary::Reason::kConverged);
      int outside = 0;
      for (Eigen::Index i = 0; i < samples.rows(); ++i) {
        outside += svm.Decision(core::Row(samples, i)) < -1e-3 * svm.rho() ? 1 : 0;
      }
      EXPECT_EQ(outside, 0);
    }
  }
}

TEST(OneClassSvmTest, NuNearBothEndsConverges) {
  core::Random random(44);
  const core::Matrix samples = Tube(300, 3, random);
  for (const double tolerance : {1e-3, 1e-7}) {  // kernel values in float, and in double
    for (const double nu : {1e-12, 1e-4, 1.0 / 300.0, 0.999, 1.0 - 1e-12}) {
      SCOPED_TRACE(testing::Message() << "nu = " << nu << ", tolerance " << tolerance);
      ExpectNuHolds(FitToTheGap(samples, {.nu = nu, .gamma = 1.0, .tolerance = tolerance}, 1e-10),
                    samples, nu, tolerance);
    }
  }
}

// Half of the samples nearly equal the others: their kernel value rounds to 1 or above.
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
      SCOPED_TRACE(testing::Message()
                   << internal::TargetName(target) << ", " << samples->rows() << " samples");
      // The first fit has kernel values in float, which shift the gap by up to 1e-7 nu m. The
      // second fit has kernel values in double.
      FitToTheGap(*samples, {.nu = 0.1, .gamma = 5.0, .tolerance = 1e-3}, 3e-5);
      FitToTheGap(*samples, {.nu = 0.1, .gamma = 5.0, .tolerance = 1e-6}, 1e-9);
    }
    internal::ForceTarget(0);
  }
}

// Sizes range from two samples to slightly more than two vectors of 16 floats.
TEST(OneClassSvmTest, TheSmallestProblemsConverge) {
  core::Random random(45);
  for (const int m : {2, 3, 15, 16, 17, 33}) {
    SCOPED_TRACE(m);
    const core::Matrix samples = Tube(m, 2, random);
    for (const double tolerance : {1e-3, 1e-8}) {
      FitToTheGap(samples, {.nu = 0.5, .gamma = 1.0, .tolerance = tolerance}, 1e-10);
    }
  }
}

}  // namespace
}  // namespace dfr::kernel
