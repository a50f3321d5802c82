#include <gtest/gtest.h>

#include <chrono>
#include <csignal>
#include <string>
#include <thread>

#include "dfr/dds/emergency_stop.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"

namespace dfr {
namespace {

using dds::EmergencyStop;
using Clock = std::chrono::steady_clock;

// A busy machine gets a minute.
bool Becomes(dds::EmergencyStopReceiver& receiver, EmergencyStop wanted) {
  const auto end = Clock::now() + std::chrono::seconds(60);
  while (Clock::now() < end) {
    if (receiver.Check(Clock::now().time_since_epoch().count()) == wanted) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return false;
}

TEST(StopTest, AnUnattendedStopSaysThatAllIsWellAndItsDeathStops) {
  const int domain = test::OwnDomain();
  dds::Participant robot({.domain = domain});
  dds::EmergencyStopReceiver receiver(robot, 1.0);
  test::PeerProcess stop(
      {DFR_HARDWARE, "stop", "--unattended", "--domain", std::to_string(domain)});
  ASSERT_TRUE(Becomes(receiver, EmergencyStop::kClear));
  stop.Signal(SIGSTOP);
  EXPECT_TRUE(Becomes(receiver, EmergencyStop::kSilent));
  stop.Signal(SIGCONT);
  EXPECT_TRUE(Becomes(receiver, EmergencyStop::kClear));
  stop.Signal(SIGINT);
  EXPECT_EQ(stop.Await(60.0), 0);
  EXPECT_TRUE(Becomes(receiver, EmergencyStop::kSilent));
}

}  // namespace
}  // namespace dfr
