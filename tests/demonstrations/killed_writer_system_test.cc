#include <gtest/gtest.h>

#include "tests/demonstrations/killed_writer.h"

namespace dfr::imitation {
namespace {

// The writes of a single episode contain more than five kills.
TEST(KilledAtEachWriteTest, EveryAcknowledgedEpisodeIsRead) { test::ExpectNoEpisodeLost(1, 51); }

}  // namespace
}  // namespace dfr::imitation
