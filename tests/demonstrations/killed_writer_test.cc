#include "tests/demonstrations/killed_writer.h"

#include <gtest/gtest.h>

namespace dfr::imitation {
namespace {

TEST(KilledWriterTest, EveryAcknowledgedEpisodeIsRead) { test::ExpectNoEpisodeLost(23, 3); }

}  // namespace
}  // namespace dfr::imitation
