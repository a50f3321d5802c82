#include <gtest/gtest.h>

#include <string>

#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"

namespace dfr::test {
namespace {

// Makes the calls of dvrk_python's test scripts in sequence, in real time. The two programs use
// different DDS implementations.
TEST(DvrkSimulatorSystemTest, AnswersAllCallsOfDvrkPythonsScripts) {
  const std::string domain = std::to_string(OwnDomain());
  const PeerProcess simulator({DFR_SIMULATOR, "--domain", domain, "--homing", "0.2"});
  EXPECT_EQ(PeerProcess({DFR_CYCLONE_SCRIPT, domain}).Await(), 0);
}

}  // namespace
}  // namespace dfr::test
