#include <gtest/gtest.h>

#include "tests/golden/golden_results.h"

namespace dfr {
namespace {

// The system tier runs eight episodes of each strategy.
TEST(GoldenTest, EveryBitOfOneEpisodeIsTheRecordedOneWithAvx2) {
  test::ExpectRecordedBits(DFR_GOLDEN_SHORT, 1);
}

}  // namespace
}  // namespace dfr
