#include <gtest/gtest.h>

#include "tests/demonstrations/killed_writer.h"

namespace dfr::imitation {
namespace {

// More kills than five an episode fall between the writes of one.
TEST(KilledAtEachWriteTest, EveryAcknowledgedEpisodeIsRead) { test::ExpectNoEpisodeLost(1, 51); }

}  // namespace
}  // namespace dfr::imitation
