#include <gtest/gtest.h>

#include <functional>
#include <set>
#include <string>

#include "dfr/robot/control_loop.h"
#include "tests/robot/control_loop_faults.h"
#include "tests/robot/fake_robot.h"

namespace dfr::robot {
namespace {

using core::PlantStatus;
using runtime::HoldReason;
using runtime::RunState;
using test::ExpectHeldUntilStarted;
using test::FakeRobot;
using test::kControl;
using test::kLong;
using test::kPeriodNs;
using test::Source;
using test::Sources;

// -- every reason to hold -------------------------------------------------------------------------

TEST(ControlLoopReasonsTest, HoldsExactlyAtTheDeadlineOfEachFault) {
  for (const Source& source : Sources()) {
    SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason));
    FakeRobot robot;
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    source.begin(robot);
    for (int n = 1; n < source.periods(); ++n) {
      ASSERT_TRUE(robot.loop.Tick()) << "too early, after " << n << " periods";
      ASSERT_EQ(robot.loop.state(), RunState::kRunning);
    }
    EXPECT_FALSE(robot.loop.Tick()) << "too late";
    EXPECT_EQ(robot.recorder.last.steady_ns, robot.clock.now_ns);
    EXPECT_EQ(robot.stop.told, robot.loop.state()) << "in the same period";
    const bool lasts = source.name != "period";
    ExpectHeldUntilStarted(robot, source.reason,
                           lasts ? [&] { source.end(robot); } : std::function<void()>());
  }
}

TEST(ControlLoopReasonsTest, AMotionEndsInThePeriodThatHolds) {
  for (const Source& source : Sources()) {
    // During the motion, while the arm comes to rest, and while the loop waits for the picture.
    for (const int begins_in : {20, 101, 105}) {
      // The control ends before the deadline.
      if (begins_in > 100 && source.deadline_ns > 0) continue;
      SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason) + " in period " +
                   std::to_string(begins_in));
      FakeRobot robot;
      ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
      const int start = robot.clock.periods;
      const std::int64_t start_ns = robot.clock.now_ns;
      // The fault begins with period `begins_in`. Before that period, even a thread that will hang
      // has reported.
      robot.clock.plan_ns = start_ns + begins_in * kPeriodNs;
      robot.clock.plan = [&] { source.begin(robot); };
      EXPECT_EQ(robot.loop.Apply(kLong), PlantStatus::kFault);
      const int late = source.name == "period" ? 1 : 0;  // the next period is late
      EXPECT_EQ(robot.clock.periods - start, begins_in + source.periods() - 1 + late);
      EXPECT_EQ(robot.recorder.last.steady_ns, robot.clock.now_ns);
      EXPECT_LE(robot.arm.setpoints, robot.clock.periods - start);
      source.end(robot);
      ExpectHeldUntilStarted(robot, source.reason);
    }
  }
}

TEST(ControlLoopReasonsTest, EveryReasonOfTheCallerHolds) {
  for (int i = 1; i < runtime::kNumHoldReasons; ++i) {
    const auto reason = static_cast<HoldReason>(i);
    SCOPED_TRACE(runtime::Name(reason));
    FakeRobot robot;
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    robot.loop.Hold(reason, "in words");
    EXPECT_FALSE(robot.loop.may_move()) << "at once";
    EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kFault);
    EXPECT_EQ(robot.loop.cause(), std::string(runtime::Name(reason)) + ": in words");
    EXPECT_FALSE(robot.loop.Tick());
    EXPECT_EQ(robot.arm.held_ns, robot.clock.now_ns) << "the arm was not told in the next period";
    ExpectHeldUntilStarted(robot, reason);
  }
}

TEST(ControlLoopReasonsTest, EveryReasonHasASource) {
  // No fault of a device causes the following reasons, so Sources() does not contain them.
  std::set<HoldReason> found = {HoldReason::kNone,           HoldReason::kControllerHalted,
                                HoldReason::kNotSeen,        HoldReason::kStateInvalid,
                                HoldReason::kControlInvalid, HoldReason::kStateJump,
                                HoldReason::kCommandRefused};
  for (const Source& source : Sources()) found.insert(source.reason);
  EXPECT_EQ(found.size(), static_cast<std::size_t>(runtime::kNumHoldReasons));
}

// -- the platform ---------------------------------------------------------------------------------

TEST(ControlLoopReasonsTest, ThePlatformRestsInThePeriodThatHolds) {
  for (const Source& source : Sources()) {
    SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason));
    FakeRobot robot;
    robot.loop.MovePlatform();
    EXPECT_EQ(robot.platform.begins, 0) << "the robot may not move";
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    robot.loop.Idle(0.1);
    EXPECT_FALSE(robot.platform.moves) << "no motion was requested";
    robot.loop.MovePlatform();
    robot.loop.Idle(0.1);
    ASSERT_TRUE(robot.platform.moves);
    source.begin(robot);
    for (int n = 0; robot.loop.Tick(); ++n) ASSERT_LT(n, source.periods());
    EXPECT_FALSE(robot.platform.moves);
    EXPECT_EQ(robot.platform.rested_ns, robot.clock.now_ns);
    source.end(robot);
    ExpectHeldUntilStarted(robot, source.reason);
    EXPECT_FALSE(robot.platform.moves) << "no motion was requested again";
  }
}

TEST(ControlLoopReasonsTest, ThePlatformRestsWhenTheTaskIsCompletedOrTheCallerHolds) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.loop.MovePlatform();
  robot.loop.Complete();
  EXPECT_FALSE(robot.platform.moves) << "at once";
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.loop.MovePlatform();
  ASSERT_TRUE(robot.platform.moves);
  robot.loop.Hold(HoldReason::kControllerHalted);
  EXPECT_FALSE(robot.platform.moves) << "at once";
}

TEST(ControlLoopReasonsTest, APlatformThatRefusesACommandIsAFault) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.platform.refuses = {HoldReason::kPlatform, "its port failed"};
  robot.loop.MovePlatform();
  EXPECT_FALSE(robot.loop.Tick());
  ExpectHeldUntilStarted(robot, HoldReason::kPlatform);
  robot.platform.refuses = {};
  robot.loop.MovePlatform();
  robot.platform.fails = {HoldReason::kPlatform, "its port failed"};
  robot.loop.Hold(HoldReason::kNotSeen);
  EXPECT_EQ(robot.loop.state(), RunState::kFaulted);
  EXPECT_EQ(robot.loop.cause(), "platform: its port failed");
  EXPECT_FALSE(robot.loop.Tick());
  ExpectHeldUntilStarted(robot, HoldReason::kPlatform, [&] { robot.platform.fails = {}; });
}

TEST(ControlLoopReasonsTest, AnyFaultEndsHomingThePlatform) {
  FakeRobot robot;
  robot.loop.Idle(1.0);
  const int start = robot.clock.periods;
  EXPECT_EQ(robot.loop.HomePlatform(1.5), HoldReason::kNone);
  EXPECT_EQ(robot.clock.periods - start, 300);
  EXPECT_EQ(robot.platform.homings, 1);
  EXPECT_FALSE(robot.platform.moves) << "the platform is at home";
  EXPECT_EQ(robot.loop.state(), RunState::kIdle);
  for (const Source& source : Sources()) {
    SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason));
    FakeRobot another;
    another.loop.Idle(1.0);
    another.clock.plan_ns = another.clock.now_ns + 50 * kPeriodNs;
    another.clock.plan = [&] { source.begin(another); };
    EXPECT_EQ(another.loop.HomePlatform(1.5), source.reason);
    EXPECT_FALSE(another.platform.moves);
    EXPECT_EQ(another.platform.rested_ns, another.clock.now_ns);
    EXPECT_LE(another.clock.periods, 200 + 50 + source.periods() + 1);
    if (source.name == "period") continue;
    EXPECT_NE(another.loop.HomePlatform(1.5), HoldReason::kNone) << "the reason lasts";
    EXPECT_EQ(another.platform.homings, 1);
  }
}

TEST(ControlLoopReasonsTest, WaitsForAPictureUntilItsDeadline) {
  constexpr int kPeriods = 401;  // the first report after 2 s
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.camera.delay = kPeriods;
  EXPECT_TRUE(robot.loop.Look());
  EXPECT_TRUE(robot.loop.may_move());
  const int start = robot.clock.periods;
  robot.camera.blind = true;
  EXPECT_FALSE(robot.loop.Look());
  EXPECT_EQ(robot.clock.periods - start, kPeriods);
  robot.camera = test::FakeCamera(robot.clock, robot.arm);
  robot.loop.Tick();
  ExpectHeldUntilStarted(robot, HoldReason::kImageSilent);
}

TEST(ControlLoopReasonsTest, ACameraThatRefusesARequestHolds) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.camera.refuses = {HoldReason::kImageSilent, "it does not answer"};
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kFault);
  robot.camera.refuses = {};
  robot.loop.Tick();
  ExpectHeldUntilStarted(robot, HoldReason::kImageSilent);
}

TEST(ControlLoopReasonsTest, ASecondReasonOfAPeriodDoesNotReplaceTheCause) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.stop.found = {HoldReason::kEmergencyStop, "pressed"};
  robot.recorder.fails = true;
  EXPECT_FALSE(robot.loop.Tick());
  EXPECT_EQ(robot.loop.cause(), "emergency-stop: pressed");
}

}  // namespace
}  // namespace dfr::robot
