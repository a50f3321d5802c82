// Problems that are too large for the unit tests.
#include <gtest/gtest.h>

#include "dfr/core/random.h"
#include "tests/kernel/smo/hard_problems.h"

namespace dfr::kernel {
namespace {

using test::Kind;

class LargeHardProblemsTest : public testing::TestWithParam<Kind> {};

// Takes seconds: only problems of this size go through the active set and the sparse rows for every
// width of the kernel, and evaluating the definition takes m^2 n operations.
TEST_P(LargeHardProblemsTest, FitsConvergeForAllSizesWidthsAndNu) {
  core::Random random(51);
  for (const int n : {1, 9, 256}) {
    test::CheckFits(GetParam(), 400, n, {1.0 / 400.0, 0.05, 0.5, 1.0}, random);
  }
  for (const int n : {1, 9}) {
    test::CheckFits(GetParam(), 2200, n, {1.0 / 2200.0, 0.05}, random);
  }
}

// G sums thousands of kernel values in float, whose errors must not hide a violation.
TEST(LargeNuTest, ThousandsOfSamplesAtTheBoundMeetTheTolerance) {
  core::Random random(59);
  for (const Kind kind : {Kind::kNormal, Kind::kDuplicates, Kind::kClusters}) {
    SCOPED_TRACE(testing::Message() << "kind " << static_cast<int>(kind));
    const core::Matrix samples = test::Samples(kind, 5300, 9, random);
    test::FitToTheGap(samples, {.nu = 0.95, .gamma = 1.0 / 9.0, .tolerance = 1e-3});
  }
}

INSTANTIATE_TEST_SUITE_P(Kinds, LargeHardProblemsTest,
                         testing::Values(Kind::kNormal, Kind::kDuplicates, Kind::kClusters,
                                         Kind::kTiny, Kind::kHuge));

}  // namespace
}  // namespace dfr::kernel
