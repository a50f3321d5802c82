#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <string>
#include <thread>

#include "dfr/sim/dvrk/psm_console_server.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"

namespace dfr::sim {
namespace {

// The calls of dvrk_python's test scripts in sequence, in real time: about 17 s on an idle machine.
TEST(PsmConsoleServerSystemTest, AnswersAllCallsOfDvrkPythonsScripts) {
  using Clock = std::chrono::steady_clock;
  PsmConsole console({.arm = "PSM1", .homing_s = 0.2});
  dds::Participant participant({.domain = test::OwnDomain()});
  PsmConsoleServer server(participant, console);
  test::PeerProcess client({DFR_CYCLONE_SCRIPT, std::to_string(test::OwnDomain())});
  for (auto last = Clock::now(); !client.Ended();) {
    const auto now = Clock::now();
    server.Tick(std::min(0.05, std::chrono::duration<double>(now - last).count()));
    last = now;
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_EQ(client.Await(), 0);
}

}  // namespace
}  // namespace dfr::sim
