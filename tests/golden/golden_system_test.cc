#include <gtest/gtest.h>

#include "tests/golden/golden_results.h"

namespace dfr {
namespace {

TEST(GoldenTest, EveryBitIsTheRecordedOneWithAvx2) { test::ExpectRecordedBits(DFR_GOLDEN, 8); }

// Takes seconds, because each instruction set runs all episodes. A defect may change the outcome of
// a single episode.
TEST(GoldenTest, OutcomesAreTheSameWithEveryInstructionSet) {
  const test::Golden widest = test::ResultsWith(0, 8);
  for (const std::int64_t target : kernel::internal::SupportedTargets()) {
    SCOPED_TRACE(kernel::internal::TargetName(target));
    EXPECT_EQ(test::ResultsWith(target, 8).outcomes, widest.outcomes);
  }
}

}  // namespace
}  // namespace dfr
