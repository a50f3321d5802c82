// Another participant joins and sends the arm a hold, in real time and over the loopback.
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <optional>
#include <thread>

#include "dfr/dds/channel.h"
#include "dfr/hardware/psm_driver.h"
#include "dfr/sim/dvrk/psm_console_server.h"
#include "tests/dds/domain.h"
#include "tests/kinematics/psm_home.h"

namespace dfr::hardware {
namespace {

using kinematics::PsmJoints;
using Clock = std::chrono::steady_clock;

// Returns options with timeouts for a busy machine.
PsmDriverOptions Patient() {
  PsmDriverOptions options;
  options.client.watchdog.max_age_s = options.client.watchdog.max_silence_s = 5.0;
  options.client.max_tick_gap_s = 5.0;
  return options;
}

class LateMessagesSystemTest : public testing::Test {
 protected:
  void SetUp() override { console_.Place(test::PsmHome()); }

  // Advances console and driver by a period of 5 ms.
  void Step() {
    next_ += std::chrono::milliseconds(5);
    std::this_thread::sleep_until(next_);
    server_.Tick(0.005);
    driver_.Tick();
  }
  // Begins a motion to the other side.
  void Begin() {
    while (driver_.Arm() != PsmStatus::kOk) Step();
    PsmJoints goal = driver_.client().setpoint();
    goal[0] = goal[0] > 0.0 ? -0.3 : 0.3;
    while (driver_.MoveTo(goal, 6.0) != PsmStatus::kOk) Step();
    for (int i = 0; i < 40; ++i) Step();
    ASSERT_TRUE(driver_.moving()) << driver_.Explain();
  }
  [[nodiscard]] Eigen::Vector3d tip() const { return console_.measured_pose().translation(); }

  sim::PsmConsole console_{{.arm = "PSM1", .homing_s = 0.2}};
  dds::Participant server_participant_{{.domain = test::OwnDomain()}};
  sim::PsmConsoleServer server_{server_participant_, console_, {}};
  dds::Participant participant_{{.domain = test::OwnDomain()}};
  PsmDriver driver_{participant_, Patient()};
  Clock::time_point next_ = Clock::now();
};

// Once the message can arrive, the arm moves at most 1 mm: 50 ms of this motion, including 10 ms
// for discovery.
TEST_F(LateMessagesSystemTest, EveryHoldOfANewcomerHolds) {
  for (int i = 0; i < 10; ++i) {
    SCOPED_TRACE(i);
    Begin();
    dds::Participant guest({.domain = test::OwnDomain(), .name = "guest"});
    dds::Publisher<dds::Signal> hold(guest, "/PSM1/hold", dds::Role::kRequest);
    std::optional<Eigen::Vector3d> there;
    double motion_m = 0.0;
    // Sends holds 20 times a second for .3 s, or one hold as soon as a subscriber is known.
    for (int n = 0; n < 120; ++n) {
      if (!there && hold.num_subscribers() > 0) {
        there = tip();
        if (i % 2 == 0) hold.Write({});
      }
      if (i % 2 != 0 && n % 10 == 0 && n < 60) hold.Write({});
      Step();
      if (there) motion_m = std::max(motion_m, (tip() - *there).norm());
    }
    ASSERT_EQ(driver_.phase(), PsmPhase::kHolding);
    EXPECT_TRUE(driver_.held_by_others()) << driver_.Explain();
    EXPECT_TRUE(there.has_value());
    EXPECT_LT(motion_m, 1e-3);
  }
}

// The console has received the message, and the driver discovers the guest up to half a second
// later.
TEST_F(LateMessagesSystemTest, EveryHoldThatOnlyTheConsoleReceivesHolds) {
  int by_the_console = 0;
  for (int i = 0; i < 10; ++i) {
    SCOPED_TRACE(i);
    Begin();
    const int late = 10 * i;  // in periods of 5 ms
    const Eigen::Vector3d there = tip();
    double motion_m = 0.0;
    std::optional<dds::Participant> guest;
    std::optional<dds::Publisher<dds::Signal>> hold;
    for (int n = 0; n < 120; ++n) {
      // The console is told to hold once, or 20 times a second for 0.3 s.
      if (n % 10 == 0 && n < (i % 2 == 0 ? 1 : 60)) console_.Hold();
      if (n == late) {
        guest.emplace(dds::ParticipantOptions{.domain = test::OwnDomain(), .name = "guest"});
        hold.emplace(*guest, "/PSM1/hold", dds::Role::kRequest);
      }
      Step();
      motion_m = std::max(motion_m, (tip() - there).norm());
    }
    ASSERT_EQ(driver_.phase(), PsmPhase::kHolding);
    EXPECT_TRUE(driver_.held_by_others()) << driver_.Explain();
    if (driver_.status() == PsmStatus::kForeignControl) {
      ++by_the_console;
      EXPECT_EQ(driver_.who(), "PSM1: control JOINT_SPACE/POSITION_MODE");
    }
    EXPECT_LT(motion_m, 1e-3);
  }
  EXPECT_GE(by_the_console, 8) << "discovery takes some ms";
}

}  // namespace
}  // namespace dfr::hardware
