#include <gtest/gtest.h>

#include <csignal>
#include <string>

#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"

namespace dfr::test {
namespace {

// Two programs of two DDS implementations, in real time.
TEST(DvrkSimulatorTest, CycloneClientHomesAndMovesTheArmAndCtrlCStopsCleanly) {
  const std::string domain = std::to_string(OwnDomain());
  PeerProcess simulator({DFR_SIMULATOR, "--domain", domain, "--homing", "0.5"});
  PeerProcess client({DFR_CYCLONE_CLIENT, domain});
  EXPECT_EQ(client.Await(90.0), 0);
  simulator.Signal(SIGINT);
  EXPECT_EQ(simulator.Await(60.0), 0);
}

TEST(DvrkSimulatorTest, WrongOptionsAreRefused) {
  EXPECT_GT(PeerProcess({DFR_SIMULATOR, "--domain", "400"}).Await(30.0), 0);
  EXPECT_EQ(PeerProcess({DFR_SIMULATOR, "--drop", "2"}).Await(30.0), 1);
  EXPECT_EQ(PeerProcess({DFR_SIMULATOR, "--help"}).Await(30.0), 0);
}

}  // namespace
}  // namespace dfr::test
