#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "dfr/robot/control_loop.h"
#include "tests/robot/control_loop_faults.h"
#include "tests/robot/fake_robot.h"

namespace dfr::robot {
namespace {

using runtime::HoldReason;
using runtime::RunState;
using test::FakeRobot;
using test::kPeriodNs;
using test::Source;
using test::Sources;
using testing::HasSubstr;

// Ends a fault. Only an operator ends the effect of a silence of the emergency stop.
void End(const Source& source, FakeRobot& robot) {
  source.end(robot);
  if (source.reason == HoldReason::kEmergencyStopSilent) static_cast<void>(robot.loop.Clear());
}

// -- starting -------------------------------------------------------------------------------------

TEST(ControlLoopStartTest, AReasonBeforeTheStartOnlyPreventsIt) {
  for (const Source& source : Sources()) {
    if (source.name == "period") continue;  // a late period is over when it is found
    SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason));
    FakeRobot robot;
    robot.loop.Tick();
    source.begin(robot);
    robot.loop.Idle(0.3);
    EXPECT_EQ(robot.loop.state(), RunState::kIdle);
    EXPECT_EQ(robot.loop.blocking(), source.reason);
    EXPECT_THAT(robot.loop.blocking_words(), HasSubstr(runtime::Name(source.reason)));
    EXPECT_EQ(robot.loop.Start(), source.reason);
    EXPECT_FALSE(robot.arm.armed());
    End(source, robot);
    EXPECT_EQ(robot.loop.Start(), HoldReason::kNone);
    EXPECT_TRUE(robot.arm.armed());
  }
}

TEST(ControlLoopStartTest, AnArmThatRefusesIsNotStarted) {
  FakeRobot robot;
  robot.arm.refuses_arm = {HoldReason::kArmJump, "frames disagree"};
  EXPECT_EQ(robot.loop.Start(), HoldReason::kArmJump);
  EXPECT_EQ(robot.loop.state(), RunState::kFaulted);
  EXPECT_EQ(robot.loop.cause(), "arm-jump: frames disagree");
}

TEST(ControlLoopStartTest, WaitsForReasonsToEndUntilItsTimeout) {
  FakeRobot robot;
  robot.arm.found = {HoldReason::kArmInvalid, "stamped zero"};
  robot.clock.plan_ns = robot.clock.now_ns + 1'000'000'000;
  robot.clock.plan = [&] { robot.arm.found = {}; };
  EXPECT_EQ(robot.loop.Start(), HoldReason::kArmInvalid) << "the loop may not wait";
  EXPECT_EQ(robot.loop.Start(3.0), HoldReason::kNone);

  FakeRobot faulted;
  ASSERT_EQ(faulted.loop.Start(), HoldReason::kNone);
  faulted.loop.Hold(HoldReason::kArmSilent);
  const std::int64_t start_ns = faulted.clock.now_ns;
  EXPECT_EQ(faulted.loop.Start(3.0), HoldReason::kArmSilent);
  EXPECT_LT(faulted.clock.now_ns - start_ns, 500'000'000) << "a fault does not end by itself";
}

// -- homing ---------------------------------------------------------------------------------------

// Before arming, faults of the camera do not matter.
bool MattersForHoming(const Source& source) {
  return source.name != "camera" && source.name != "camera's thread hangs";
}

TEST(ControlLoopStartTest, HomesOnlyOnRequest) {
  FakeRobot robot;
  robot.arm.unhomed = true;
  robot.camera.found = {HoldReason::kImageInvalid, "dark"};
  EXPECT_FALSE(robot.loop.AwaitReady(0.5, {}));
  EXPECT_TRUE(robot.loop.AwaitHomeable(0.5, {}));
  robot.loop.Idle(10.0);
  EXPECT_EQ(robot.arm.homings, 0) << "nothing requested homing";
  EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
  EXPECT_EQ(robot.arm.homings, 1);
  EXPECT_FALSE(robot.arm.unhomed);
  robot.camera.found = {};
  EXPECT_EQ(robot.loop.Start(), HoldReason::kNone);
  EXPECT_EQ(robot.loop.Home(), HoldReason::kOperator) << "it is armed";
  robot.loop.Halt();
  EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
  EXPECT_EQ(robot.arm.homings, 1) << "the arm is homed already";
}

TEST(ControlLoopStartTest, DoesNotPowerUpWithAReasonToHold) {
  for (const Source& source : Sources()) {
    if (source.name == "period" || !MattersForHoming(source)) continue;
    SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason));
    FakeRobot robot;
    robot.arm.unhomed = true;
    robot.loop.Tick();
    source.begin(robot);
    robot.loop.Idle(0.3);
    EXPECT_FALSE(robot.loop.AwaitHomeable(0.5, {}));
    EXPECT_EQ(robot.loop.Home(), source.reason);
    EXPECT_EQ(robot.arm.homings, 0);
    End(source, robot);
    EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
  }
}

TEST(ControlLoopStartTest, HomingEndsExactlyAtTheDeadlineOfEachFault) {
  for (const Source& source : Sources()) {
    if (!MattersForHoming(source)) continue;
    SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason));
    FakeRobot robot;
    robot.arm.unhomed = true;
    robot.loop.Idle(0.5);
    // The fault begins half a second after homing has begun.
    const std::int64_t begins_ns = robot.clock.now_ns + 750'000'000;
    robot.clock.plan_ns = begins_ns;
    robot.clock.plan = [&] { source.begin(robot); };
    EXPECT_EQ(robot.loop.Home(), source.reason);
    EXPECT_EQ(robot.arm.homings, 1);
    EXPECT_TRUE(robot.arm.unhomed);
    EXPECT_EQ(robot.arm.disabled_ns, robot.clock.now_ns) << "in the period that finds it";
    const int late = source.name == "period" ? 1 : 0;  // the next period is late
    EXPECT_LE(robot.clock.now_ns - begins_ns,
              (source.periods() + late - 1) * kPeriodNs + (late != 0 ? 50'000'000 : 0));
    End(source, robot);
    robot.loop.Idle(5.0);
    EXPECT_TRUE(robot.arm.unhomed) << "homing continued by itself";
    EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
  }
}

TEST(ControlLoopStartTest, HomingDoesNotAcknowledgeTheEmergencyStop) {
  FakeRobot robot;
  robot.arm.unhomed = true;
  robot.stop.pressed = true;
  robot.loop.Idle(0.1);
  robot.stop.pressed = false;
  robot.loop.Idle(3.0);
  EXPECT_EQ(robot.loop.Home(), HoldReason::kEmergencyStop);
  EXPECT_EQ(robot.arm.homings, 0);
  static_cast<void>(robot.loop.Clear());
  EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
}

TEST(ControlLoopStartTest, ClearAcknowledgesTheEmergencyStop) {
  for (const bool started : {false, true}) {
    FakeRobot robot;
    if (started) {
      ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    }
    robot.stop.found = {HoldReason::kEmergencyStop, "pressed"};
    robot.loop.Idle(0.3);
    EXPECT_FALSE(robot.loop.Clear());
    EXPECT_EQ(robot.stop.acknowledged, 1);
    robot.stop.found = {};
    EXPECT_TRUE(robot.loop.Clear());
    EXPECT_EQ(robot.loop.state(), RunState::kIdle);
  }
}

// Nobody could have stopped the robot during the silence.
TEST(ControlLoopStartTest, ASilenceOfAConnectedStopBlocksUntilClear) {
  FakeRobot robot;
  robot.stop.found = {HoldReason::kEmergencyStopSilent, "not connected yet"};
  robot.loop.Idle(1.0);
  robot.stop.found = {};
  robot.loop.Idle(1.0);
  EXPECT_EQ(robot.loop.stop_silence_s(), 0.0);
  EXPECT_EQ(robot.loop.blocking(), HoldReason::kNone);
  for (const double seconds : {1.0, 0.5}) {
    robot.stop.found = {HoldReason::kEmergencyStopSilent, "lost"};
    robot.loop.Idle(seconds);
    robot.stop.found = {};
    robot.loop.Idle(1.0);
  }
  EXPECT_NEAR(robot.loop.stop_silence_s(), 1.5, 1e-9);
  EXPECT_EQ(robot.loop.Start(1.0), HoldReason::kEmergencyStopSilent);
  EXPECT_EQ(robot.loop.Home(), HoldReason::kEmergencyStopSilent);
  EXPECT_EQ(robot.loop.blocking_words(),
            "emergency-stop-silent: its messages were overdue for 1.50 s");
  const std::int64_t start_ns = robot.clock.now_ns;
  EXPECT_FALSE(robot.loop.AwaitReady(10.0, {}));
  EXPECT_LT(robot.clock.now_ns - start_ns, 500'000'000) << "waiting does not help";
  robot.stop.found = {HoldReason::kEmergencyStopSilent, "lost"};
  EXPECT_FALSE(robot.loop.Clear()) << "the silence lasts";
  robot.stop.found = {};
  robot.loop.Idle(1.0);
  EXPECT_EQ(robot.loop.Start(), HoldReason::kEmergencyStopSilent);
  ASSERT_TRUE(robot.loop.Clear());
  EXPECT_EQ(robot.loop.stop_silence_s(), 0.0);
  EXPECT_EQ(robot.loop.Start(), HoldReason::kNone);
}

TEST(ControlLoopStartTest, WaitingEndsAtOnceWhenInterruptedOrStopped) {
  for (const bool interrupted : {true, false}) {
    FakeRobot robot;
    robot.interrupted = interrupted;
    robot.stop.found = {interrupted ? HoldReason::kEmergencyStopSilent : HoldReason::kEmergencyStop,
                        "in words"};
    const std::int64_t start_ns = robot.clock.now_ns;
    EXPECT_FALSE(robot.loop.AwaitReady(10.0, {}));
    EXPECT_LT(robot.clock.now_ns - start_ns, 500'000'000);
  }
}

TEST(ControlLoopStartTest, ReportsOnceTheReasonForWaiting) {
  FakeRobot robot;
  std::vector<std::string> said;
  const auto say = [&](std::string_view words) { said.emplace_back(words); };
  robot.stop.found = {HoldReason::kEmergencyStopSilent, "is it running?"};
  robot.clock.plan_ns = robot.clock.now_ns + 5'000'000'000;
  robot.clock.plan = [&] { robot.stop.found = {}; };
  EXPECT_TRUE(robot.loop.AwaitReady(10.0, say));
  EXPECT_THAT(said, testing::ElementsAre("waiting: emergency-stop-silent: is it running?"));

  robot.stop.found = {HoldReason::kEmergencyStopSilent, "is it running?"};
  const std::int64_t start_ns = robot.clock.now_ns;
  EXPECT_FALSE(robot.loop.AwaitReady(10.0, {}));
  EXPECT_NEAR(1e-9 * static_cast<double>(robot.clock.now_ns - start_ns), 10.0, 0.2);
}

TEST(ControlLoopStartTest, EpisodesEndRegularlyWhenCompletedHaltedOrNotSeen) {
  FakeRobot robot;
  EXPECT_TRUE(robot.loop.ended_regularly());
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.loop.Complete();
  EXPECT_EQ(robot.loop.state(), RunState::kIdle);
  EXPECT_TRUE(robot.loop.ended_regularly());
  EXPECT_TRUE(robot.arm.armed());
  for (int n = 0; n < 2; ++n) {
    robot.loop.Halt();
    EXPECT_FALSE(robot.arm.armed()) << "in every state";
  }
  for (int i = 1; i < runtime::kNumHoldReasons; ++i) {
    const auto reason = static_cast<HoldReason>(i);
    FakeRobot other;
    ASSERT_EQ(other.loop.Start(), HoldReason::kNone);
    other.loop.Hold(reason);
    EXPECT_EQ(other.loop.ended_regularly(),
              reason == HoldReason::kControllerHalted || reason == HoldReason::kNotSeen)
        << runtime::Name(reason);
  }
}

}  // namespace
}  // namespace dfr::robot
