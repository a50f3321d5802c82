#include <gtest/gtest.h>

#include "tests/demonstrations/killed_writer.h"

namespace dfr::imitation {
namespace {

// Each of the ten episodes takes more than five writes.
TEST(KilledAtEachWriteTest, EveryAcknowledgedEpisodeIsRead) { test::ExpectNoEpisodeLost(1, 51); }

}  // namespace
}  // namespace dfr::imitation
