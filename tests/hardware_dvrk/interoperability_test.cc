// Our client and a console written with CycloneDDS, an independent implementation.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <csignal>
#include <functional>
#include <string>
#include <thread>

#include "dfr/hardware/psm_driver.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/support/all_close.h"

namespace dfr::hardware {
namespace {

using Clock = std::chrono::steady_clock;

using kinematics::PsmJoints;
using testing::HasSubstr;

PsmJoints Yaw(double angle) {
  PsmJoints q = PsmJoints::Zero();
  q[0] = angle;
  q[2] = 0.12;
  return q;
}

class CycloneConsoleTest : public testing::Test {
 protected:
  static PsmDriverOptions Patient() {
    PsmDriverOptions options;
    options.client.watchdog = {.max_age_s = 0.5, .max_silence_s = 0.5, .max_ahead_s = 0.01};
    options.client.max_tick_gap_s = 2.0;
    return options;
  }

  bool Until(const std::function<bool()>& condition) {
    const auto end = Clock::now() + std::chrono::seconds(60);
    while (!condition()) {
      if (Clock::now() > end) return false;
      driver_.Tick();
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    return true;
  }

  dds::Participant participant_{{.domain = test::OwnDomain()}};
  PsmDriver driver_{participant_, Patient()};
};

TEST_F(CycloneConsoleTest, IsHomedMovedAndMeasured) {
  test::PeerProcess console({DFR_CYCLONE_CONSOLE, std::to_string(test::OwnDomain())});
  ASSERT_EQ(BringUp(driver_, 60.0), PsmStatus::kOk) << driver_.Explain();
  EXPECT_TRUE(test::AllClose(driver_.client().measured_cp().position_m,
                             Eigen::Vector3d(0.0, 0.0, -0.1135), 1e-12));
  PsmJoints goal = Yaw(0.05);
  goal << 0.05, -0.03, 0.125, 0.1, 0.05, -0.05;
  ASSERT_EQ(driver_.MoveTo(goal, 1.0), PsmStatus::kOk);
  ASSERT_TRUE(Until([&] { return driver_.at_rest(); })) << driver_.Explain();
  ASSERT_TRUE(Until([&] {
    return test::AllClose(driver_.client().measured_js().position, goal, 1e-9);
  })) << driver_.Explain();
  EXPECT_EQ(driver_.phase(), PsmPhase::kArmed);
  // A console that dies.
  console.Signal(SIGKILL);
  ASSERT_TRUE(Until([&] { return driver_.phase() == PsmPhase::kHolding; }));
  EXPECT_EQ(driver_.status(), PsmStatus::kStateSilent);
}

TEST_F(CycloneConsoleTest, FaultIsToldInItsOwnWords) {
  const test::PeerProcess console({DFR_CYCLONE_CONSOLE, std::to_string(test::OwnDomain()), "0.03"});
  ASSERT_EQ(BringUp(driver_, 60.0), PsmStatus::kOk) << driver_.Explain();
  ASSERT_EQ(driver_.MoveTo(Yaw(0.1), 1.0), PsmStatus::kOk);
  ASSERT_TRUE(Until([&] { return driver_.phase() == PsmPhase::kHolding; }));
  EXPECT_THAT(driver_.status(), testing::AnyOf(PsmStatus::kConsoleFault, PsmStatus::kConsoleError));
  EXPECT_THAT(driver_.Explain(), HasSubstr("\"PSM1: yaw motor, over temperature\""));
  EXPECT_LT(driver_.client().setpoint()[0], 0.05);
  ASSERT_TRUE(Until([&] { return driver_.client().hold_reason() == PsmStatus::kConsoleFault; }));
  EXPECT_EQ(driver_.Home(), PsmStatus::kConsoleFault);
}

}  // namespace
}  // namespace dfr::hardware
