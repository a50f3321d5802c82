#include "tests/kernel/smo/hard_problems.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"
#include "tests/kernel/libsvm_peer.h"
#include "tests/support/message_of.h"

namespace dfr::kernel {
namespace {

using test::Kind;
using test::LibsvmPeer;
using test::MedianSquaredDistance;
using test::Samples;
using testing::HasSubstr;

class HardProblemsTest : public testing::TestWithParam<Kind> {};

// The system tier has larger problems.
TEST_P(HardProblemsTest, FitsConvergeForAllSizesWidthsAndNu) {
  core::Random random(51);
  for (const int m : {2, 7, 60, 200}) {
    for (const int n : {1, 9, 256}) {
      if (m * n <= 60 * 256) test::CheckFits(GetParam(), m, n, {1.0 / m, 0.05, 0.5, 1.0}, random);
    }
  }
}

TEST_P(HardProblemsTest, ObjectivesAreNoHigherThanThoseOfLibsvm) {
  constexpr double kTolerance = 1e-3;
  core::Random random(52);
  for (const int m : {7, 60, 200}) {
    for (const int n : {1, 9}) {
      const core::Matrix samples = Samples(GetParam(), m, n, random);
      const double unit = 1.0 / MedianSquaredDistance(samples);
      for (const double width : {1e-3, 0.1, 1.0, 10.0, 1e3}) {
        for (const double nu : {0.05, 0.5}) {
          SCOPED_TRACE(testing::Message()
                       << m << " x " << n << ", width " << width << ", nu " << nu);
          const double gamma = width * unit;
          const LibsvmPeer peer(samples, nu, gamma, kTolerance);
          FitSummary summary;
          (void)OneClassSvm::Fit(samples, {.nu = nu, .gamma = gamma, .tolerance = kTolerance},
                                 &summary);
          // Both objectives are within tolerance * nu m of the minimum; LIBSVM's kernel is float.
          EXPECT_LE(summary.objective, peer.Objective() * (1.0 + 1e-6) + kTolerance * nu * m);
        }
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Kinds, HardProblemsTest,
                         testing::Values(Kind::kNormal, Kind::kDuplicates, Kind::kClusters,
                                         Kind::kTiny, Kind::kHuge));

// One distant sample moves the mean, and therefore changes the rounding of all coordinates in
// float.
TEST(HardProblemsTest, OneOutlierChangesNothingForTheOthers) {
  core::Random random(53);
  for (const int m : {400, 2100}) {  // solved as a whole, and by an active set
    const core::Matrix samples = Samples(Kind::kNormal, m, 3, random);
    for (const double outlier : {1e6, 1e100}) {
      for (const double gamma : {0.3, 30.0}) {
        SCOPED_TRACE(testing::Message() << m << ", " << outlier << ", gamma " << gamma);
        core::Matrix spoilt = samples;
        spoilt.row(m / 2).setConstant(outlier);
        const auto svm = test::FitToTheGap(spoilt, {.gamma = gamma, .tolerance = 1e-3});
        int outside = 0;
        for (Eigen::Index i = 0; i < m; ++i) {
          outside += svm.Decision(core::Row(spoilt, i)) < -2e-3 / svm.libsvm_scale() ? 1 : 0;
        }
        EXPECT_LE(outside, 0.05 * m);
      }
    }
  }
}

// Neither mean nor median is near all clusters: float cannot distinguish samples within a cluster.
TEST(HardProblemsTest, ClustersManyWidthsApartConverge) {
  core::Random random(54);
  for (const int m : {400, 2100}) {
    for (const double apart : {1e4, 1e8}) {
      for (const double gamma : {0.3, 5.0}) {
        SCOPED_TRACE(testing::Message() << m << ", apart " << apart << ", gamma " << gamma);
        core::Matrix samples = Samples(Kind::kNormal, m, 3, random);
        for (Eigen::Index i = 0; i < m; ++i) samples(i, 0) += apart * static_cast<double>(i % 5);
        test::FitToTheGap(samples, {.gamma = gamma, .tolerance = 1e-3});
      }
    }
  }
}

// A fit stopped at any time, even during a pass over all samples, is an estimate with a known
// error. Takes about a second: only a fit of 4000 samples or more begins with a subsample.
TEST(HardProblemsTest, AFitMayBeStoppedAtAnyTime) {
  core::Random random(56);
  const int m = 4100;
  const core::Matrix samples = Samples(Kind::kNormal, m, 3, random);
  for (const double gamma : {0.3, 100.0}) {  // with rows of all samples, and with sparse rows
    const OneClassSvmOptions options{.gamma = gamma, .tolerance = 1e-3};
    int calls = 0;
    const auto stopped_at = [&](int call) {
      calls = 0;
      OneClassSvmOptions stopped = options;
      stopped.progress = [&](const FitProgress& p) {
        EXPECT_GE(p.iterations, 0);
        EXPECT_GE(p.kkt_gap, 0.0);
        return ++calls != call;
      };
      FitSummary summary;
      const auto svm = OneClassSvm::Fit(samples, stopped, &summary);
      EXPECT_TRUE(std::isfinite(svm.rho()));
      EXPECT_NEAR(svm.alpha().sum(), 1.0, 1e-12);
      if (call > 0 && std::isfinite(summary.kkt_gap)) {
        EXPECT_NEAR(test::GapOf(svm, summary, samples, options.nu), summary.kkt_gap, 1e-4);
      }
      return summary;
    };
    EXPECT_EQ(stopped_at(-1).reason, FitSummary::Reason::kConverged);
    const int all = calls;
    ASSERT_GE(all, 4);
    for (const int call : {1, all / 2, all - 1}) {
      SCOPED_TRACE(testing::Message() << "gamma " << gamma << ", call " << call << " of " << all);
      const FitSummary summary = stopped_at(call);
      EXPECT_EQ(calls, call) << "called again after the stop";
      EXPECT_EQ(summary.reason, FitSummary::Reason::kInterrupted);
      if (call == 1) {
        EXPECT_TRUE(std::isinf(summary.kkt_gap)) << "stopped before G was known";
      }
    }
  }
}

// A fit whose gap is below its tolerance has converged and reports no more progress.
TEST(HardProblemsTest, ReportedGapsAreAtLeastTheTolerance) {
  core::Random random(57);
  const core::Matrix all = Samples(Kind::kNormal, 4100, 3, random);
  const std::vector<double> weights(2100, 1.0);
  const std::vector<double> start(2100, 1.0);
  for (const int m : {500, 2100, 4100}) {
    for (const double gamma : {0.3, 100.0}) {
      for (const bool weighted : {false, true}) {
        for (const bool started : {false, true}) {
          if ((weighted || started) && (m != 2100 || weighted == started)) continue;
          SCOPED_TRACE(testing::Message() << m << " samples, gamma " << gamma << ", weighted "
                                          << weighted << ", started " << started);
          OneClassSvmOptions options{.nu = 0.1, .gamma = gamma, .tolerance = 1e-3};
          if (weighted) options.weights = weights;
          if (started) options.start = start;
          int calls = 0;
          options.progress = [&](const FitProgress& p) {
            ++calls;
            // A weighted fit reports while it confirms the gap of its last step.
            if (weighted && calls > 1) {
              EXPECT_GT(p.kkt_gap, 0.0) << "call " << calls;
            } else {
              EXPECT_GE(p.kkt_gap, p.tolerance) << "call " << calls;
            }
            return true;
          };
          (void)OneClassSvm::Fit(all.topRows(m), options);
          EXPECT_GE(calls, 1);
        }
      }
    }
  }
}

TEST(HardProblemsTest, SamplesWhoseSquaredDistancesOverflowAreNamed) {
  core::Random random(55);
  core::Matrix samples = Samples(Kind::kNormal, 400, 3, random);
  samples(123, 2) = 1e200;
  EXPECT_THAT(
      dfr::test::MessageOf<std::invalid_argument>([&] { (void)OneClassSvm::Fit(samples, {}); }),
      testing::AllOf(HasSubstr("sample 123, entry 2 is 1e+200"),
                     HasSubstr("Leave the sample out")));
}

}  // namespace
}  // namespace dfr::kernel
