// `hardware check` and `hardware stop` with the simulated console, in real time.
#include <gtest/gtest.h>

#include <csignal>
#include <string>

#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"

namespace dfr::test {
namespace {

TEST(CheckSystemTest, HomesAndMovesTheSimulatedArm) {
  const std::string domain = std::to_string(OwnDomain());
  const PeerProcess simulator(
      {DFR_SIMULATOR, "--no-camera", "--homing", "0.2", "--domain", domain});
  PeerProcess stop({DFR_HARDWARE, "stop", "--unattended", "--domain", domain});
  // An idle machine finds both programs in an estimated 1 s. --wait allows twenty times as long.
  const auto check = [&] {
    return PeerProcess({DFR_HARDWARE, "check", "--arm", "PSM1", "--home", "--move", "--yes",
                        "--domain", domain, "--wait", "20", "--seconds", "0.5"})
        .Await();
  };
  EXPECT_EQ(check(), 0);
  stop.Signal(SIGKILL);
  EXPECT_EQ(check(), 1) << "it moved without an emergency stop";
}

}  // namespace
}  // namespace dfr::test
