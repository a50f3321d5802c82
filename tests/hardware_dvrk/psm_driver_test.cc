#include "dfr/hardware/psm_driver.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <functional>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "dfr/dds/channel.h"
#include "dfr/sim/dvrk/psm_console_server.h"
#include "tests/dds/domain.h"
#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::hardware {
namespace {

using Clock = std::chrono::steady_clock;
using kinematics::PsmJoints;
using testing::HasSubstr;

PsmJoints Home() {
  PsmJoints q = PsmJoints::Zero();
  q[2] = 0.12;
  return q;
}

PsmJoints Yaw(double angle) {
  PsmJoints q = Home();
  q[0] = angle;
  return q;
}

// Limits that forgive a machine that is busy with other things; the exact ones are tested without
// a network.
PsmDriverOptions Patient() {
  PsmDriverOptions options;
  options.client.watchdog = {.max_age_s = 0.5, .max_silence_s = 0.5, .max_ahead_s = 0.01};
  options.client.max_tick_gap_s = 2.0;
  return options;
}

// A simulated console in a thread of its own, in real time, and a driver that this thread ticks.
class PsmDriverTest : public testing::Test {
 protected:
  PsmDriverTest() : console_thread_([this] { Serve(); }) {}
  ~PsmDriverTest() override {
    stop_ = true;
    console_thread_.join();
  }

  void Serve() {
    auto last = Clock::now();
    while (!stop_) {
      const auto now = Clock::now();
      const std::lock_guard lock(mutex_);
      if (!halted_) {
        server_.Tick(std::min(0.05, std::chrono::duration<double>(now - last).count()));
      }
      last = now;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  }

  void Console(const std::function<void()>& change) {
    const std::lock_guard lock(mutex_);
    change();
  }

  bool Until(PsmDriver& driver, const std::function<bool()>& condition) {
    const auto end = Clock::now() + std::chrono::seconds(60);
    while (!condition()) {
      if (Clock::now() > end) return false;
      driver.Tick();
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    return true;
  }

  void ExpectHolds(PsmDriver& driver, PsmStatus cause) {
    ASSERT_TRUE(Until(driver, [&] { return driver.phase() == PsmPhase::kHolding; }))
        << driver.Explain();
    EXPECT_EQ(driver.status(), cause) << driver.Explain();
  }

  sim::PsmConsole console_{{.arm = "PSM1", .homing_s = 0.2}};
  dds::Participant server_participant_{{.domain = test::OwnDomain()}};
  sim::PsmConsoleServer server_{server_participant_, console_};
  dds::Participant participant_{{.domain = test::OwnDomain()}};
  std::mutex mutex_;
  std::atomic<bool> stop_{false};
  bool halted_ = false;
  std::thread console_thread_;
};

TEST_F(PsmDriverTest, HomesMovesAndComesToRest) {
  PsmDriver driver(participant_, Patient());
  std::vector<std::string> said;
  ASSERT_EQ(BringUp(driver, 60.0, [&](std::string_view text) { said.emplace_back(text); }),
            PsmStatus::kOk)
      << driver.Explain();
  EXPECT_THAT(said, testing::Contains(HasSubstr("homed")));
  PsmJoints goal = Home();
  goal << 0.05, -0.03, 0.125, 0.1, 0.05, -0.05;
  ASSERT_EQ(driver.MoveTo(goal, 1.0), PsmStatus::kOk);
  ASSERT_EQ(driver.MoveJaw(0.3, 1.0), PsmStatus::kOk);
  ASSERT_TRUE(Until(driver, [&] { return driver.at_rest(); })) << driver.Explain();
  // At rest is within rest_options of the goal; the console goes on to it.
  EXPECT_TRUE(test::AllClose(driver.client().measured_js().position, goal, 0.02));
  Console([&] {
    EXPECT_TRUE(test::AllClose(console_.setpoint_joints(), goal, 1e-9));
    EXPECT_NEAR(console_.setpoint_jaw(), 0.3, 1e-12);
  });
  EXPECT_EQ(driver.other_publishers(), 0);
}

// Goals that the console refuses are refused here first.
TEST_F(PsmDriverTest, NothingIsAskedOfTheConsoleWhereNothingMayMove) {
  PsmDriver driver(participant_, Patient());
  EXPECT_EQ(BringUp(driver, 60.0, {}, [] { return false; }), PsmStatus::kHeld);
  Console([&] { EXPECT_EQ(console_.state(), sim::ArmState::kDisabled); });
}

TEST_F(PsmDriverTest, HomingEndsWithTheArmDisabledWhenItMayNoLongerMove) {
  Console([&] { console_ = sim::PsmConsole({.arm = "PSM1", .homing_s = 30.0}); });
  const auto homes = [&] {
    const std::lock_guard lock(mutex_);
    return console_.busy();
  };
  const auto disabled = [&] {
    const auto end = Clock::now() + std::chrono::seconds(60);
    while (Clock::now() < end) {
      const std::lock_guard lock(mutex_);
      if (console_.state() == sim::ArmState::kDisabled) return true;
    }
    return false;
  };
  {
    PsmDriver driver(participant_, Patient());
    EXPECT_EQ(BringUp(driver, 60.0, {}, [&] { return !homes(); }), PsmStatus::kHeld);
    EXPECT_TRUE(disabled());
  }
  {
    PsmDriver driver(participant_, Patient());
    ASSERT_EQ(driver.Home(), PsmStatus::kOk);
    ASSERT_TRUE(Until(driver, homes)) << driver.Explain();
  }
  EXPECT_TRUE(disabled()) << "a driver that goes away leaves an arm that homes";
}

TEST_F(PsmDriverTest, NothingBeyondTheLimitsReachesTheConsole) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  EXPECT_EQ(driver.MoveTo(Yaw(1.6), 60.0), PsmStatus::kBeyondLimits);
  EXPECT_EQ(driver.MoveTo(Yaw(0.3), 0.2), PsmStatus::kTooFast);
  ASSERT_EQ(driver.MoveTo(Yaw(0.02), 0.5), PsmStatus::kOk);
  ASSERT_TRUE(Until(driver, [&] { return driver.at_rest(); })) << driver.Explain();
  ConsoleWord word;
  while (driver.TakeWord(word)) EXPECT_EQ(word.severity, ConsoleWord::Severity::kStatus);
}

TEST_F(PsmDriverTest, NotReadyIsRefusedByItsName) {
  PsmDriver driver(participant_, Patient());
  ASSERT_TRUE(Until(driver, [&] { return driver.status() == PsmStatus::kDisabled; }));
  EXPECT_EQ(driver.Arm(), PsmStatus::kDisabled);
  EXPECT_EQ(driver.MoveTo(Yaw(0.1), 1.0), PsmStatus::kNotArmed);
  ASSERT_EQ(driver.Enable(), PsmStatus::kOk);
  ASSERT_TRUE(Until(driver, [&] { return driver.phase() == PsmPhase::kIdle; }));
  EXPECT_EQ(driver.Arm(), PsmStatus::kNotHomed);
  EXPECT_THAT(driver.Explain(), HasSubstr("PSM1: the arm is not homed; home the arm"));
}

TEST_F(PsmDriverTest, FaultIsToldInTheConsolesWordsAndNeedsDisableHomeArm) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  ASSERT_EQ(driver.MoveTo(Yaw(0.2), 3.0), PsmStatus::kOk);
  ASSERT_TRUE(Until(driver, [&] { return driver.client().setpoint()[0] > 0.01; }));
  Console([&] { console_.Fail("encoder 3 is off"); });
  ASSERT_TRUE(Until(driver, [&] { return driver.phase() == PsmPhase::kHolding; }));
  EXPECT_THAT(driver.status(), testing::AnyOf(PsmStatus::kConsoleFault, PsmStatus::kConsoleError));
  EXPECT_THAT(driver.Explain(), HasSubstr("\"PSM1: encoder 3 is off\""));
  EXPECT_EQ(BringUp(driver, 60.0), PsmStatus::kConsoleFault);
  ASSERT_EQ(driver.Request(PsmRequest::kDisable), PsmStatus::kOk);
  ASSERT_TRUE(Until(driver, [&] { return driver.status() == PsmStatus::kDisabled; }));
  EXPECT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
}

TEST_F(PsmDriverTest, PauseStampZeroNanAndFreezeEachHoldByName) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  const auto rearm = [&] {
    Console([&] { server_.SetFaults({}); });
    return Until(driver, [&] { return driver.Arm() == PsmStatus::kOk; });
  };
  Console([&] { server_.SetFaults({.invalid = true}); });
  ExpectHolds(driver, PsmStatus::kStateInvalid);
  ASSERT_TRUE(rearm());
  Console([&] { server_.SetFaults({.corrupt = true}); });
  ExpectHolds(driver, PsmStatus::kStateNotFinite);
  ASSERT_TRUE(rearm());
  Console([&] { server_.SetFaults({.freeze = true}); });
  ExpectHolds(driver, PsmStatus::kStateOld);
  ASSERT_TRUE(rearm());
  Console([&] { server_.SetFaults({.silent = true}); });
  ExpectHolds(driver, PsmStatus::kStateSilent);
  ASSERT_TRUE(rearm());
  Console([&] { console_.StateCommand("pause"); });
  ExpectHolds(driver, PsmStatus::kPaused);
  ASSERT_EQ(driver.Request(PsmRequest::kResume), PsmStatus::kOk);
  ASSERT_TRUE(Until(driver, [&] { return driver.phase() == PsmPhase::kIdle; }));
  ASSERT_TRUE(rearm());
}

// A console that stops without a word, and goes on.
TEST_F(PsmDriverTest, HaltedConsoleHoldsAndNothingRestartsByItself) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  ASSERT_EQ(driver.MoveTo(Yaw(0.2), 3.0), PsmStatus::kOk);
  ASSERT_TRUE(Until(driver, [&] { return driver.client().setpoint()[0] > 0.01; }));
  PsmJoints before;
  Console([&] {
    halted_ = true;
    before = console_.setpoint_joints();
  });
  ExpectHolds(driver, PsmStatus::kStateSilent);
  // Long enough for the last set-point, which nobody took, to expire.
  std::this_thread::sleep_for(std::chrono::milliseconds(100));
  Console([&] { halted_ = false; });
  ASSERT_TRUE(Until(driver, [&] { return driver.client().hold_reason() == PsmStatus::kOk; }));
  for (int i = 0; i < 100; ++i) {
    driver.Tick();
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  EXPECT_EQ(driver.phase(), PsmPhase::kHolding);
  // What it had been told last it may still have reached.
  Console([&] { EXPECT_TRUE(test::AllClose(console_.setpoint_joints(), before, 1e-3)); });
}

TEST_F(PsmDriverTest, AnyOtherPublisherOnACommandTopicHolds) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  dds::Participant intruder({.domain = test::OwnDomain()});
  {
    const dds::Publisher<dds::PoseStamped> second(intruder, "/PSM1/servo_cp", dds::Role::kCommand);
    ExpectHolds(driver, PsmStatus::kOtherPublisher);
    EXPECT_EQ(driver.Arm(), PsmStatus::kOtherPublisher);
  }
  ASSERT_TRUE(Until(driver, [&] { return driver.Arm() == PsmStatus::kOk; })) << driver.Explain();
  const dds::Publisher<dds::JointState> second(intruder, "/PSM1/move_jp", dds::Role::kRequest);
  ExpectHolds(driver, PsmStatus::kOtherPublisher);
}

TEST_F(PsmDriverTest, EveryTopicThatCommandsTheArmIsWatched) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  dds::Participant intruder({.domain = test::OwnDomain()});
  // Also those whose types are not known here: any will do.
  for (const char* topic : {"servo_cr", "servo_jr", "servo_jf", "servo_cs", "body/servo_cf",
                            "move_jr", "interpolate_cp", "jaw/servo_jf", "jaw/move_jp"}) {
    SCOPED_TRACE(topic);
    {
      const dds::Publisher<dds::Text> second(intruder, std::string("/PSM1/") + topic,
                                             dds::Role::kRequest);
      ExpectHolds(driver, PsmStatus::kOtherPublisher);
    }
    ASSERT_TRUE(Until(driver, [&] { return driver.Arm() == PsmStatus::kOk; })) << driver.Explain();
  }
  const dds::Publisher<dds::Text> elsewhere(intruder, "/PSM11/servo_cs", dds::Role::kRequest);
  const dds::Publisher<dds::Text> nearby(intruder, "/PSM1/servo", dds::Role::kRequest);
  for (int i = 0; i < 100; ++i) {
    driver.Tick();
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  EXPECT_EQ(driver.phase(), PsmPhase::kArmed) << driver.Explain();
}

TEST_F(PsmDriverTest, WhatOthersSayOfTheArmIsHold) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  dds::Participant other({.domain = test::OwnDomain()});
  const auto holds = [&](PsmStatus cause, const std::function<void()>& say,
                         const std::function<void()>& unsay = {}) {
    SCOPED_TRACE(Name(cause));
    const auto end = Clock::now() + std::chrono::seconds(60);
    while (driver.phase() == PsmPhase::kArmed && Clock::now() < end) {
      say();  // until it is heard
      for (int i = 0; i < 20 && driver.phase() == PsmPhase::kArmed; ++i) {
        driver.Tick();
        std::this_thread::sleep_for(std::chrono::milliseconds(2));
      }
    }
    EXPECT_EQ(driver.phase(), PsmPhase::kHolding);
    EXPECT_EQ(driver.status(), cause) << driver.Explain();
    if (unsay) unsay();
    EXPECT_TRUE(Until(driver, [&] { return driver.Arm() == PsmStatus::kOk; })) << driver.Explain();
  };
  dds::Publisher<dds::Signal> hold(other, "/PSM1/hold", dds::Role::kRequest);
  dds::Publisher<dds::Signal> free(other, "/PSM1/free", dds::Role::kRequest);
  dds::Publisher<dds::StringStamped> state(other, "/PSM1/state_command", dds::Role::kRequest);
  holds(PsmStatus::kForeignWord, [&] { hold.Write({}); });
  holds(PsmStatus::kForeignWord, [&] { free.Write({}); });
  holds(PsmStatus::kForeignWord, [&] { state.Write({{}, "", "enable"}); });
  dds::Publisher<dds::Flag> following(other, "/MTMR_PSM1/following", dds::Role::kEvent);
  dds::Publisher<dds::Flag> enabled(other, "/console/teleop/enabled", dds::Role::kRequest);
  holds(
      PsmStatus::kTeleoperated, [&] { following.Write({true}); },
      [&] { following.Write({false}); });
  holds(
      PsmStatus::kTeleoperated, [&] { enabled.Write({true}); }, [&] { enabled.Write({false}); });
  dds::Publisher<dds::Joy> clutch(other, "/PSM1/arm_clutch", dds::Role::kEvent);
  dds::Publisher<dds::Joy> before(other, "/PSM1/manip_clutch", dds::Role::kEvent);
  for (dds::Publisher<dds::Joy>* button : {&clutch, &before}) {
    holds(
        PsmStatus::kClutched,
        [&] {
          button->Write({{}, "", {}, {1}});
        },
        [&] {
          button->Write({{}, "", {}, {0}});
        });
  }
  dds::Publisher<dds::Text> tool(other, "/PSM1/tool_type", dds::Role::kEvent);
  tool.Write({"LARGE_NEEDLE_DRIVER:400006"});
  for (int i = 0; i < 50; ++i) {
    driver.Tick();
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  EXPECT_EQ(driver.phase(), PsmPhase::kArmed) << driver.Explain();
  holds(PsmStatus::kToolChanged, [&] { tool.Write({"LARGE_NEEDLE_DRIVER_SI:420006"}); });
  holds(
      PsmStatus::kWrongTool, [&] { tool.Write({"PROGRASP_FORCEPS:400093"}); },
      [&] { tool.Write({"LARGE_NEEDLE_DRIVER:400006"}); });
}

// An Si takes no instrument of a Classic: who has one is a Classic, whatever the owner says.
TEST_F(PsmDriverTest, AnArmSaidToBeAnSiIsNotArmedWithAClassicsInstrument) {
  PsmDriverOptions options = Patient();
  options.client.limits.generation = kinematics::PsmGeneration::kSi;
  PsmDriver driver(participant_, options);
  EXPECT_EQ(BringUp(driver, 5.0), PsmStatus::kWrongTool);
  EXPECT_THAT(driver.Explain(), HasSubstr("of generation Si 420006"));
}

TEST_F(PsmDriverTest, ASecondConsoleHolds) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  dds::Participant other({.domain = test::OwnDomain()});
  const dds::Publisher<dds::JointState> second(other, "/PSM1/measured_js", dds::Role::kState);
  ExpectHolds(driver, PsmStatus::kSecondConsole);
  EXPECT_EQ(driver.Arm(), PsmStatus::kSecondConsole);
}

// The console moves the arm by itself, where no topic shows it but the set-point. Meanwhile it
// drops what clients send: taking that as well, a busy machine's console might not move at all.
TEST_F(PsmDriverTest, ASetpointThatTheConsoleMovesByItselfHolds) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  Console([&] { server_.SetFaults({.drop_commands = 1.0}); });
  double yaw = 0.0;
  std::uint64_t samples = 0;
  const auto end = Clock::now() + std::chrono::seconds(60);
  while (driver.phase() == PsmPhase::kArmed && Clock::now() < end) {
    if (driver.client().num_samples() != samples) {  // no farther than the driver can have seen
      samples = driver.client().num_samples();
      yaw = std::min(0.05, yaw + 0.001);
      Console([&] { console_.ServoJp(Yaw(yaw)); });
    }
    driver.Tick();
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_EQ(driver.status(), PsmStatus::kForeignSetpoint) << driver.Explain();
  EXPECT_LT(driver.client().measured_js().position[0], 0.05) << "not before it is far away";
}

TEST_F(PsmDriverTest, HoldStopsTheArmWhereItIs) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  ASSERT_EQ(driver.MoveTo(Yaw(0.2), 3.0), PsmStatus::kOk);
  ASSERT_TRUE(Until(driver, [&] { return driver.client().setpoint()[0] > 0.05; }));
  driver.Hold();
  driver.Tick();
  EXPECT_EQ(driver.status(), PsmStatus::kHeld);
  const double stopped_at = driver.client().setpoint()[0];
  ASSERT_TRUE(Until(driver, [&] { return driver.at_rest(); }));
  Console([&] { EXPECT_NEAR(console_.measured_joints()[0], stopped_at, 5e-3); });
}

// From the first tick to the last, whatever DDS does meanwhile.
TEST_F(PsmDriverTest, TickNeverAllocates) {
  PsmDriver driver(participant_, Patient());
  ASSERT_EQ(BringUp(driver, 60.0), PsmStatus::kOk) << driver.Explain();
  const PsmJoints goal = Yaw(0.05);
  for (int i = 0; i < 300; ++i) {
    {
      const test::NoAlloc guard;
      driver.Tick();
      if (i == 10) (void)driver.MoveTo(goal, 0.5);
      if (i == 200) driver.Hold();
      ConsoleWord word;
      (void)driver.TakeWord(word);
    }
    if (i == 150) Console([&] { console_.StateCommand("dance"); });  // a warning comes
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
  }
  EXPECT_EQ(driver.status(), PsmStatus::kHeld);
}

// A console and a driver whose time is this test's: what was sent before Flush() has arrived when
// the console goes on.
class PsmDriverLockStepTest : public testing::Test {
 protected:
  static PsmDriverOptions Options() {
    PsmDriverOptions options;
    options.arm = "PSM2";
    options.client.profile = PsmProfile::kLinear;
    options.client.longest_step_s = 0.02;
    // Stamps are of the system's clock, which this test leaves alone.
    options.client.watchdog = {.max_age_s = 1e3, .max_silence_s = 1.0, .max_ahead_s = 1e3};
    return options;
  }
  void Step(double dt_s) {
    now_ns_ += std::llround(1e9 * dt_s);
    driver_.Tick(now_ns_, dds::Stamp::Now().nanoseconds());
    driver_.Flush();
    server_.Tick(dt_s);
    // The console's words come when they come.
    std::this_thread::sleep_for(std::chrono::milliseconds(2));
    driver_.Flush();
  }
  void ArmNow() {
    for (int i = 0; i < 5000 && driver_.status() != PsmStatus::kDisabled; ++i) Step(0.01);
    ASSERT_EQ(driver_.Home(), PsmStatus::kOk);
    Rearm();
  }
  void Rearm() {
    for (int i = 0; i < 5000 && driver_.Arm() != PsmStatus::kOk; ++i) Step(0.01);
    ASSERT_EQ(driver_.phase(), PsmPhase::kArmed) << driver_.Explain();
  }

  sim::PsmConsole console_{{.arm = "PSM2", .homing_s = 0.1}};
  dds::Participant server_participant_{{.domain = test::OwnDomain()}};
  sim::PsmConsoleServer server_{server_participant_, console_};
  dds::Participant participant_{{.domain = test::OwnDomain()}};
  PsmDriver driver_{participant_, Options()};
  std::int64_t now_ns_ = 0;
};

TEST_F(PsmDriverLockStepTest, TimeGoesOnAsTheCallerSays) {
  ArmNow();
  ASSERT_EQ(driver_.MoveTo(Yaw(0.01), 0.2), PsmStatus::kOk);
  for (int i = 1; i <= 10; ++i) {
    Step(0.02);
    EXPECT_NEAR(console_.setpoint_joints()[0], 0.001 * i, 1e-12) << i;
  }
}

// From the moment at which the operator's word has arrived: nothing is sent any more after 20 ms of
// the loop's time, and the reason names whose hand it is.
TEST_F(PsmDriverLockStepTest, AnOperatorsHandOnTheArmHoldsWithin20Milliseconds) {
  dds::Participant other({.domain = test::OwnDomain()});
  dds::Publisher<dds::Flag> following(other, "/MTMR_PSM2/following", dds::Role::kEvent);
  dds::Publisher<dds::Flag> enabled(other, "/console/teleop/enabled", dds::Role::kEvent);
  dds::Publisher<dds::Joy> clutch(other, "/PSM2/arm_clutch", dds::Role::kEvent);
  dds::Publisher<dds::Text> tool(other, "/PSM2/tool_type", dds::Role::kEvent);
  // Who else publishes here has said how it stands, and is heard.
  tool.Write({"LARGE_NEEDLE_DRIVER:400006"});
  const auto heard_by_driver = [&] {
    return following.num_subscribers() + enabled.num_subscribers() + clutch.num_subscribers() > 2 &&
           tool.num_subscribers() > 0;
  };
  for (int i = 0; i < 5000 && !heard_by_driver(); ++i) Step(0.01);
  ASSERT_TRUE(heard_by_driver());
  ArmNow();
  constexpr double kPeriod = 0.005;
  constexpr int kPeriods = 4;  // 20 ms
  const auto holds = [&](PsmStatus cause, const char* words, const std::function<void()>& say,
                         const std::function<void()>& unsay) {
    SCOPED_TRACE(words);
    ASSERT_EQ(driver_.MoveTo(Yaw(driver_.client().setpoint()[0] > 0.1 ? 0.0 : 0.2), 5.0),
              PsmStatus::kOk);
    for (int i = 0; i < 10; ++i) Step(kPeriod);
    ASSERT_TRUE(driver_.moving()) << driver_.Explain();
    say();
    // The way through the system's sockets, in which the loop's time stands still.
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
    driver_.Flush();
    const std::uint64_t sent = driver_.setpoints_sent();
    int periods = 0;
    while (driver_.phase() == PsmPhase::kArmed && periods < 100) {
      Step(kPeriod);
      ++periods;
    }
    EXPECT_LE(periods, kPeriods);
    EXPECT_EQ(driver_.status(), cause) << driver_.Explain();
    EXPECT_THAT(driver_.Explain(), HasSubstr(words));
    EXPECT_LT(driver_.setpoints_sent() - sent, kPeriods);
    for (int i = 0; i < 5; ++i) Step(kPeriod);  // the console has heard of it
    const PsmJoints there = console_.setpoint_joints();
    for (int i = 0; i < 20; ++i) Step(kPeriod);
    EXPECT_TRUE(test::AllClose(console_.setpoint_joints(), there, 1e-12)) << "it goes on";
    unsay();
    Rearm();
  };
  holds(
      PsmStatus::kTeleoperated, "teleoperated", [&] { following.Write({true}); },
      [&] { following.Write({false}); });
  holds(
      PsmStatus::kTeleoperated, "teleoperated", [&] { enabled.Write({true}); },
      [&] { enabled.Write({false}); });
  holds(
      PsmStatus::kClutched, "clutch",
      [&] {
        clutch.Write({{}, "", {}, {1}});
      },
      [&] {
        clutch.Write({{}, "", {}, {0}});
      });
  holds(
      PsmStatus::kToolChanged, "instrument was changed",
      [&] { tool.Write({"LARGE_NEEDLE_DRIVER_SI:420006"}); }, [] {});
}

TEST(PsmDriverNoConsoleTest, SaysThatNobodyIsThere) {
  dds::Participant participant({.domain = test::OwnDomain()});
  PsmDriver driver(participant, {.arm = "PSM3"});
  EXPECT_EQ(driver.Tick(), PsmStatus::kNoConsole);
  EXPECT_EQ(BringUp(driver, 0.2), PsmStatus::kNoConsole);
  EXPECT_THAT(driver.Explain(), HasSubstr("is the console (or dvrk_simulator) running"));
  EXPECT_THROW(PsmDriver(participant, {.arm = "/PSM1"}), std::invalid_argument);
}

// Poses are relative to a camera; set-points go out with their twist.
class PsmDriverOnCartTest : public testing::Test {
 protected:
  static sim::PsmConsoleOptions Cart() {
    sim::PsmConsoleOptions options{.arm = "PSM1", .homing_s = 0.1};
    options.base_frame.translation() = Eigen::Vector3d(0.05, -0.1, 0.2);
    options.base_frame.linear() =
        Eigen::AngleAxisd(2.0, Eigen::Vector3d(1.0, -1.0, 0.5).normalized()).toRotationMatrix();
    options.base_frame_name = "ECM_view";
    return options;
  }
  bool Until(PsmDriver& driver, const std::function<bool()>& condition) {
    const auto end = Clock::now() + std::chrono::seconds(60);
    auto last = Clock::now();
    while (!condition()) {
      const auto now = Clock::now();
      if (now > end) return false;
      server_.Tick(std::min(0.05, std::chrono::duration<double>(now - last).count()));
      last = now;
      driver.Tick();
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return true;
  }

  sim::PsmConsole console_{Cart()};
  dds::Participant server_participant_{{.domain = test::OwnDomain()}};
  sim::PsmConsoleServer server_{server_participant_, console_};
  dds::Participant participant_{{.domain = test::OwnDomain()}};
};

TEST_F(PsmDriverOnCartTest, MovesTheArmInItsOwnFrameByStatesWithTwists) {
  PsmDriverOptions options = Patient();
  options.servo_cs = true;
  PsmDriver driver(participant_, options);
  dds::Subscriber<dds::CartesianState> heard(server_participant_, "/PSM1/servo_cs",
                                             dds::Role::kState);
  dds::Subscriber<dds::PoseStamped> poses(server_participant_, "/PSM1/servo_cp", dds::Role::kState);
  console_.Place(Home());
  ASSERT_TRUE(Until(driver, [&] { return driver.Arm() == PsmStatus::kOk; })) << driver.Explain();
  EXPECT_TRUE(
      test::AllClose(driver.client().base_frame().matrix(), Cart().base_frame.matrix(), 1e-9));
  // Found by now, so that nothing goes out on servo_cp any more.
  ASSERT_TRUE(Until(driver, [&] {
    dds::CartesianState state;
    return heard.TakeNewest(state) && state.pose_valid && state.twist_valid;
  }));
  dds::PoseStamped pose;
  while (poses.Take(pose)) {
  }
  ASSERT_EQ(driver.MoveTo(Yaw(0.1), 2.0), PsmStatus::kOk);
  double fastest = 0.0;
  ASSERT_TRUE(Until(driver, [&] {
    dds::CartesianState state;
    while (heard.Take(state)) fastest = std::max(fastest, state.linear_m_s.norm());
    return driver.at_rest() || driver.phase() != PsmPhase::kArmed;
  }));
  EXPECT_EQ(driver.status(), PsmStatus::kOk) << driver.Explain();
  EXPECT_TRUE(test::AllClose(console_.setpoint_joints(), Yaw(0.1), 1e-9));
  // 0.1 rad in 2 s, 1.5 times as fast in the middle, 0.1135 m from the remote centre.
  EXPECT_NEAR(fastest, 1.5 * 0.05 * 0.1135, 1e-3);
  EXPECT_FALSE(poses.Take(pose)) << "both ways at once";
}

}  // namespace
}  // namespace dfr::hardware
