// Fits in which most alphas end at the upper bound.
#include <gtest/gtest.h>

#include <utility>

#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"
#include "tests/kernel/smo/hard_problems.h"

namespace dfr::kernel {
namespace {

using test::Kind;
using test::Samples;

// One computation of G evaluates the kernel between each support vector and each sample.
TEST(LargeNuTest, AFitEvaluatesLittleMoreThanOneGradient) {
  core::Random random(57);
  for (const auto& [count, nu] :
       {std::pair(2100, 0.5), std::pair(2100, 1.0), std::pair(4100, 0.8)}) {
    SCOPED_TRACE(testing::Message() << count << " samples, nu " << nu);
    const core::Matrix samples = Samples(Kind::kNormal, count, 3, random);
    FitSummary summary;
    test::FitToTheGap(samples, {.nu = nu, .gamma = 0.3, .tolerance = 1e-3}, 0.0, &summary);
    EXPECT_LT(static_cast<double>(summary.kernel_evaluations),
              1.6 * static_cast<double>(summary.num_support_vectors) * count);
  }
}

// The matrix is symmetric: half of it suffices, including at the start.
TEST(LargeNuTest, ASmallFitEvaluatesHalfTheMatrix) {
  constexpr int kSamples = 400;
  core::Random random(60);
  const core::Matrix samples = Samples(Kind::kNormal, kSamples, 3, random);
  for (const double gamma : {0.3, 100.0}) {  // many neighbours, and few
    for (const double nu : {0.3, 0.8}) {
      SCOPED_TRACE(testing::Message() << "gamma " << gamma << ", nu " << nu);
      FitSummary summary;
      test::FitToTheGap(samples, {.nu = nu, .gamma = gamma, .tolerance = 1e-3}, 0.0, &summary);
      EXPECT_LE(summary.kernel_evaluations, kSamples * (kSamples + 1) / 2);
    }
  }
}

}  // namespace
}  // namespace dfr::kernel
