#include <gtest/gtest.h>

#include <chrono>
#include <csignal>
#include <functional>
#include <string>
#include <thread>

#include "dfr/hardware/psm_driver.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"

namespace dfr::hardware {
namespace {

using Clock = std::chrono::steady_clock;

bool Within(double limit_s, PsmDriver& driver, const std::function<bool()>& condition) {
  const auto end = Clock::now() + std::chrono::duration<double>(limit_s);
  while (!condition()) {
    if (Clock::now() > end) return false;
    driver.Tick();
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  return true;
}

// A driver and the simulated console, both by this machine's clocks, until the console is killed.
TEST(DvrkSimulatorSystemTest, DriverMovesTheArmAndHoldsWhenTheSimulatorDies) {
  const std::string domain = std::to_string(test::OwnDomain());
  test::PeerProcess simulator({DFR_SIMULATOR, "--domain", domain, "--homing", "0.5"});
  dds::Participant participant({.domain = test::OwnDomain()});
  PsmDriverOptions options;
  // five times a client's timeout, for a busy machine
  options.client.watchdog.max_age_s = options.client.watchdog.max_silence_s = 0.5;
  options.client.max_tick_gap_s = 0.5;
  PsmDriver driver(participant, options);
  // 40 times the 1.5 s of an idle machine.
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  kinematics::PsmJoints goal = driver.client().setpoint();
  goal[0] += 0.05;
  ASSERT_EQ(driver.MoveTo(goal, 1.0), PsmStatus::kOk);
  // 25 times the 1.2 s of an idle machine.
  ASSERT_TRUE(Within(30.0, driver, [&] { return driver.at_rest(); })) << driver.Explain();
  simulator.Signal(SIGKILL);
  // 10 times the 0.5 s of an idle machine.
  ASSERT_TRUE(Within(5.0, driver, [&] { return driver.phase() == PsmPhase::kHolding; }));
  EXPECT_EQ(driver.status(), PsmStatus::kStateSilent);
}

}  // namespace
}  // namespace dfr::hardware
