#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <string>

#include "dfr/sim/dvrk/psm_console_server.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"

namespace dfr::sim {
namespace {

// The calls of dvrk_python's test scripts, one after another, in real time: some 17 s on an idle
// machine, of which 14 times as much are granted.
TEST(PsmConsoleServerSystemTest, AnswersWhateverTheScriptsOfDvrkPythonAsk) {
  using Clock = std::chrono::steady_clock;
  PsmConsole console({.arm = "PSM1", .homing_s = 0.2});
  dds::Participant participant({.domain = test::OwnDomain()});
  PsmConsoleServer server(participant, console);
  test::PeerProcess client({DFR_CYCLONE_SCRIPT, std::to_string(test::OwnDomain())});
  int code = -1;
  const auto end = Clock::now() + std::chrono::seconds(240);
  for (auto last = Clock::now(); code < 0 && last < end;) {
    const auto now = Clock::now();
    server.Tick(std::min(0.05, std::chrono::duration<double>(now - last).count()));
    last = now;
    code = client.Await(1e-3);
  }
  EXPECT_EQ(code, 0);
}

}  // namespace
}  // namespace dfr::sim
