#include "dfr/robot/control_loop.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/robot/fake_robot.h"
#include "tests/support/no_alloc.h"

namespace dfr::robot {
namespace {

using core::PlantStatus;
using runtime::HoldReason;
using runtime::RunState;
using test::FakeRobot;
using test::kPeriodNs;
using testing::HasSubstr;

constexpr std::array kControl = {0.3, 0.4};  // 0.5 mm in 5 periods
constexpr std::array kLong = {6.0, 8.0};     // 100 periods
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// A fault during the loop: its beginning, its end, and the deadline of the hold.
struct Source {
  std::string name;
  HoldReason reason;
  std::function<void(FakeRobot&)> begin;
  std::function<void(FakeRobot&)> end;
  std::int64_t deadline_ns = 0;  // 0: none, it counts in the period in which it is found

  // Periods from begin() to the one that must hold: the first one after the deadline.
  [[nodiscard]] int periods() const { return static_cast<int>(deadline_ns / kPeriodNs) + 1; }
};

std::vector<Source> Sources() {
  std::vector<Source> all;
  for (const HoldReason reason :
       {HoldReason::kArmSilent, HoldReason::kArmInvalid, HoldReason::kArmOld, HoldReason::kArmJump,
        HoldReason::kArmNotReady, HoldReason::kArmNotFollowing, HoldReason::kSecondCommander,
        HoldReason::kClock, HoldReason::kOverrun}) {
    all.push_back({"arm", reason,
                   [=](FakeRobot& r) {
                     r.arm.found = {reason, "the arm says so"};
                   },
                   [](FakeRobot& r) { r.arm.found = {}; }});
  }
  for (const HoldReason reason : {HoldReason::kImageSilent, HoldReason::kImageOld,
                                  HoldReason::kImageInvalid, HoldReason::kClock}) {
    all.push_back({"camera", reason,
                   [=](FakeRobot& r) {
                     r.camera.found = {reason, "it says"};
                   },
                   [](FakeRobot& r) { r.camera.found = {}; }});
  }
  for (const HoldReason reason : {HoldReason::kEmergencyStop, HoldReason::kEmergencyStopSilent}) {
    all.push_back({"stop", reason,
                   [=](FakeRobot& r) {
                     r.stop.found = {reason, "it says"};
                   },
                   [](FakeRobot& r) { r.stop.found = {}; }});
  }
  all.push_back({"camera's thread hangs", HoldReason::kImageSilent,
                 [](FakeRobot& r) { r.camera.hangs = true; },
                 [](FakeRobot& r) { r.camera.hangs = false; }, 250'000'000});
  all.push_back({"stop's thread hangs", HoldReason::kEmergencyStopSilent,
                 [](FakeRobot& r) { r.stop.hangs = true; },
                 [](FakeRobot& r) { r.stop.hangs = false; }, 100'000'000});
  all.push_back({"period", HoldReason::kOverrun,
                 [](FakeRobot& r) { r.clock.late_ns = 50'000'000 - kPeriodNs + 1; },
                 [](FakeRobot&) {}});
  all.push_back({"clock", HoldReason::kArmSilent,
                 [](FakeRobot& r) {
                   r.clock.found = {HoldReason::kArmSilent, "it stands"};
                 },
                 [](FakeRobot& r) { r.clock.found = {}; }});
  all.push_back({"recorder", HoldReason::kRecorder, [](FakeRobot& r) { r.recorder.fails = true; },
                 [](FakeRobot& r) { r.recorder.fails = false; }});
  all.push_back({"platform", HoldReason::kPlatform,
                 [](FakeRobot& r) {
                   r.platform.found = {HoldReason::kPlatform, "it was unplugged"};
                 },
                 [](FakeRobot& r) { r.platform.found = {}; }});
  all.push_back({"operator", HoldReason::kOperator, [](FakeRobot& r) { r.interrupted = true; },
                 [](FakeRobot& r) { r.interrupted = false; }});
  return all;
}

// The robot holds for `reason`, and only the operator's confirmation makes it move again.
void ExpectHeldUntilStarted(FakeRobot& robot, HoldReason reason,
                            const std::function<void()>& mend = {}) {
  EXPECT_EQ(robot.loop.state(), runtime::IsFault(reason) ? RunState::kFaulted : RunState::kHolding);
  EXPECT_FALSE(robot.loop.may_move());
  EXPECT_FALSE(robot.arm.armed());
  EXPECT_EQ(robot.recorder.last.reason, reason);
  EXPECT_THAT(robot.loop.cause(), HasSubstr(runtime::Name(reason)));
  const int setpoints = robot.arm.setpoints;
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kFault);
  if (mend) {
    EXPECT_NE(robot.loop.Start(), HoldReason::kNone) << "the reason lasts";
    EXPECT_FALSE(robot.loop.Clear());
    mend();
  }
  robot.loop.Idle(2.0);
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kFault) << "nobody has started it";
  EXPECT_EQ(robot.arm.setpoints, setpoints) << "it moved";
  if (runtime::IsFault(reason)) {
    EXPECT_NE(robot.loop.Start(), HoldReason::kNone) << "a fault has to be cleared";
    EXPECT_TRUE(robot.loop.Clear());
  }
  EXPECT_EQ(robot.loop.Start(), HoldReason::kNone);
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
}

// -- every reason to hold -------------------------------------------------------------------------

TEST(ControlLoopTest, HoldsExactlyAtTheDeadlineOfEverythingItWatches) {
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

TEST(ControlLoopTest, AMotionEndsInThePeriodThatHolds) {
  for (const Source& source : Sources()) {
    // In the motion, while the arm comes to rest, while the picture is waited for.
    for (const int begins_in : {20, 101, 105}) {
      if (begins_in > 100 && source.deadline_ns > 0) continue;  // over before the deadline
      SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason) + " in period " +
                   std::to_string(begins_in));
      FakeRobot robot;
      ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
      const int start = robot.clock.periods;
      const std::int64_t start_ns = robot.clock.now_ns;
      // At the beginning of that period; a hanging thread has checked in the previous one.
      robot.clock.plan_ns = start_ns + begins_in * kPeriodNs;
      robot.clock.plan = [&] { source.begin(robot); };
      EXPECT_EQ(robot.loop.Apply(kLong), PlantStatus::kFault);
      const int late = source.name == "period" ? 1 : 0;  // it is the next one that is late
      EXPECT_EQ(robot.clock.periods - start, begins_in + source.periods() - 1 + late);
      EXPECT_EQ(robot.recorder.last.steady_ns, robot.clock.now_ns);
      EXPECT_LE(robot.arm.setpoints, robot.clock.periods - start);
      source.end(robot);
      ExpectHeldUntilStarted(robot, source.reason);
    }
  }
}

TEST(ControlLoopTest, EveryReasonThatTheCallerFindsHoldsToo) {
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

TEST(ControlLoopTest, NoReasonIsLeftWithoutASource) {
  // Faults that the controller, the task and the next tests detect.
  std::set<HoldReason> found = {HoldReason::kNone,           HoldReason::kControllerHalted,
                                HoldReason::kNotSeen,        HoldReason::kStateInvalid,
                                HoldReason::kControlInvalid, HoldReason::kStateJump,
                                HoldReason::kCommandRefused};
  for (const Source& source : Sources()) found.insert(source.reason);
  EXPECT_EQ(found.size(), static_cast<std::size_t>(runtime::kNumHoldReasons));
}

// -- the platform ---------------------------------------------------------------------------------

TEST(ControlLoopTest, ThePlatformRestsInThePeriodThatHolds) {
  for (const Source& source : Sources()) {
    SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason));
    FakeRobot robot;
    robot.loop.MovePlatform();
    EXPECT_EQ(robot.platform.begins, 0) << "the robot may not move";
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    robot.loop.Idle(0.1);
    EXPECT_FALSE(robot.platform.moves) << "nobody has said so";
    robot.loop.MovePlatform();
    robot.loop.Idle(0.1);
    ASSERT_TRUE(robot.platform.moves);
    source.begin(robot);
    for (int n = 0; robot.loop.Tick(); ++n) ASSERT_LT(n, source.periods());
    EXPECT_FALSE(robot.platform.moves);
    EXPECT_EQ(robot.platform.rested_ns, robot.clock.now_ns);
    source.end(robot);
    ExpectHeldUntilStarted(robot, source.reason);
    EXPECT_FALSE(robot.platform.moves) << "nobody has said so again";
  }
}

TEST(ControlLoopTest, ThePlatformRestsWhenTheTaskIsCompletedOrTheCallerHolds) {
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

TEST(ControlLoopTest, APlatformThatCannotBeToldIsAFaultForAsLong) {
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

TEST(ControlLoopTest, HomingThePlatformEndsWithWhateverIsFound) {
  FakeRobot robot;
  robot.loop.Idle(1.0);
  const int start = robot.clock.periods;
  EXPECT_EQ(robot.loop.HomePlatform(1.5), HoldReason::kNone);
  EXPECT_EQ(robot.clock.periods - start, 300);
  EXPECT_EQ(robot.platform.homings, 1);
  EXPECT_FALSE(robot.platform.moves) << "it is there";
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

TEST(ControlLoopTest, APeriodOfJustTheLimitIsNoOverrun) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.clock.late_ns = 50'000'000 - kPeriodNs;
  EXPECT_TRUE(robot.loop.Tick());
  robot.clock.late_ns = 50'000'000 - kPeriodNs + 1;
  EXPECT_FALSE(robot.loop.Tick());
}

TEST(ControlLoopTest, APictureIsWaitedForUntilItsDeadline) {
  constexpr int kPeriods = 401;  // the first after 2 s
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

TEST(ControlLoopTest, ACameraThatCannotBeAskedIsAReason) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.camera.refuses = {HoldReason::kImageSilent, "it does not answer"};
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kFault);
  robot.camera.refuses = {};
  robot.loop.Tick();
  ExpectHeldUntilStarted(robot, HoldReason::kImageSilent);
}

TEST(ControlLoopTest, ASecondReasonOfAPeriodDoesNotReplaceTheCause) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.stop.found = {HoldReason::kEmergencyStop, "pressed"};
  robot.recorder.fails = true;
  EXPECT_FALSE(robot.loop.Tick());
  EXPECT_EQ(robot.loop.cause(), "emergency-stop: pressed");
}

// -- controls -------------------------------------------------------------------------------------

TEST(ControlLoopTest, AControlMovesTheArmAndIsSeenAtRest) {
  FakeRobot robot({.image_latency_s = 0.05});
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  const int start = robot.clock.periods;
  ASSERT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk) << robot.loop.cause();
  ASSERT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk) << robot.loop.cause();
  EXPECT_NEAR(robot.arm.at[0], 0.6e-3, 1e-15);
  EXPECT_NEAR(robot.arm.at[1], 0.8e-3, 1e-15);
  EXPECT_NEAR(robot.loop.observation()[0], 0.6, 1e-12);
  EXPECT_NEAR(robot.loop.observation()[1], 0.8, 1e-12);
  EXPECT_EQ(robot.arm.setpoints, 10);
  EXPECT_EQ(robot.camera.questions, 2);
  // Five periods of motion, three until rest, four until the picture.
  EXPECT_EQ(robot.clock.periods - start, 2 * (5 + 3 + 4));
  EXPECT_EQ(robot.camera.after_ns,
            robot.clock.WallNs() - robot.camera.delay * kPeriodNs + 50'000'000);
  EXPECT_EQ(robot.stop.told, RunState::kRunning);
  EXPECT_EQ(robot.stop.beats, robot.clock.periods);
}

TEST(ControlLoopTest, AnInvalidControlIsRefused) {
  for (const std::vector<double>& control :
       {std::vector<double>{kNan, 0.0}, {0.0, INFINITY}, {0.1}, {0.1, 0.1, 0.1}}) {
    FakeRobot robot;
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    EXPECT_EQ(robot.loop.Apply(control), PlantStatus::kRefused);
    EXPECT_EQ(robot.arm.setpoints, 0);
    robot.loop.Halt();
    ExpectHeldUntilStarted(robot, HoldReason::kControlInvalid);
  }
}

TEST(ControlLoopTest, AControlOutOfReachIsRefused) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.task.unreachable = true;
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kRefused);
  robot.task.unreachable = false;
  robot.loop.Halt();
  ExpectHeldUntilStarted(robot, HoldReason::kCommandRefused);

  robot.arm.refuses_motion = {HoldReason::kCommandRefused, "too fast"};
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kRefused);
  EXPECT_EQ(robot.loop.cause(), "command-refused: too fast");
  robot.arm.refuses_motion = {};
  robot.loop.Halt();
  ExpectHeldUntilStarted(robot, HoldReason::kCommandRefused);
}

TEST(ControlLoopTest, AStateThatJumpedIsAReason) {
  for (const double sign : {-1.0, 1.0}) {
    FakeRobot robot({.max_state_jump = 2.0, .max_drift = 1e3, .drift_noise = 1e3});
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    ASSERT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
    robot.camera.off = {1.2 - 1e-9, sign * 1.6};  // of length 2
    EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk) << "just within the limit";
    robot.camera.off = {2.4, sign * 3.2};
    EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kFault);
    robot.loop.Tick();
    ExpectHeldUntilStarted(robot, HoldReason::kStateJump);
  }
}

TEST(ControlLoopTest, PicturesThatShowNothingAreTriedAgain) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.camera.unseen = 2;
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
  EXPECT_EQ(robot.camera.questions, 3);
  EXPECT_NEAR(robot.loop.observation()[0], 0.3, 1e-12);
  // The state is NaN then, which a controller halts at; it is no fault of a device.
  robot.camera.unseen = 3;
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
  EXPECT_EQ(robot.camera.questions, 6);
  EXPECT_TRUE(std::isnan(robot.loop.observation()[0]));
}

TEST(ControlLoopTest, TheControllersDecisionsMakeTheState) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  const auto decide = [&](control::Mode mode, control::HaltCause cause = {}) {
    control::Step step;
    step.mode = mode;
    step.cause = cause;
    robot.loop.Decided(step);
    return robot.loop.state();
  };
  EXPECT_EQ(decide(control::Mode::kPolicy), RunState::kRunning);
  EXPECT_EQ(decide(control::Mode::kProbe), RunState::kRecovering);
  EXPECT_EQ(decide(control::Mode::kRecovery), RunState::kRecovering);
  EXPECT_EQ(decide(control::Mode::kPolicy), RunState::kRunning);
  EXPECT_EQ(decide(control::Mode::kHalt, control::HaltCause::kNoProgress), RunState::kHolding);
  EXPECT_THAT(robot.loop.cause(), HasSubstr(control::Name(control::HaltCause::kNoProgress)));
  EXPECT_TRUE(robot.loop.ended_regularly());
  robot.loop.Halt();
  ExpectHeldUntilStarted(robot, HoldReason::kControllerHalted);
  EXPECT_EQ(decide(control::Mode::kHalt, control::HaltCause::kControlInvalid), RunState::kHolding);
  EXPECT_THAT(robot.loop.cause(), HasSubstr("control-invalid"));
}

// -- pictures that are from now -------------------------------------------------------------------

// Applies controls of `size` mm until it holds; the way of the tip until then, mm.
double WayUntilHeld(FakeRobot& robot, double size, int most = 100) {
  const std::array<double, 2> begin = robot.arm.at;
  const std::array control = {0.6 * size, 0.8 * size};
  for (int i = 0; i < most && robot.loop.Apply(control) == PlantStatus::kOk; ++i) {
  }
  return 1e3 * std::hypot(robot.arm.at[0] - begin[0], robot.arm.at[1] - begin[1]);
}

TEST(ControlLoopTest, PicturesThatDoNotShowTheMotionHold) {
  for (const double size : {0.05, 0.2, 0.5, 1.0, 2.0, 2.8}) {
    for (const double noise : {0.0, 0.1}) {
      SCOPED_TRACE(testing::Message() << size << " mm each, noise " << noise);
      FakeRobot robot;
      ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
      ASSERT_TRUE(robot.loop.Look());
      for (int i = 0; i < 20; ++i) ASSERT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
      robot.camera.frozen = true;
      robot.camera.off = {noise, -noise};
      EXPECT_LT(WayUntilHeld(robot, size), 3.0);
      EXPECT_EQ(robot.loop.cause(), "image-invalid: the pictures do not show the arm's motion");
      EXPECT_EQ(robot.loop.state(), RunState::kFaulted);
    }
  }
}

TEST(ControlLoopTest, PicturesThatAreLateWithFreshStampsHold) {
  for (const double size : {0.5, 1.0, 2.0, 2.8}) {
    SCOPED_TRACE(size);
    FakeRobot robot;
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    ASSERT_TRUE(robot.loop.Look());
    for (int i = 0; i < 10; ++i) ASSERT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
    robot.camera.pictures_late = 6;  // for example 2 s, with controls of a third of a second
    EXPECT_LT(WayUntilHeld(robot, size), 3.0);
    EXPECT_EQ(robot.loop.state(), RunState::kFaulted) << robot.loop.cause();
  }
}

TEST(ControlLoopTest, MotionThatNobodyCommandedHolds) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  ASSERT_TRUE(robot.loop.Look());
  int applied = 0;
  // 0.2 mm to the side with each control of 0.1 mm forth or back.
  for (; applied < 100; ++applied) {
    robot.camera.off[0] += 0.2;
    const std::array control = {0.0, applied % 2 == 0 ? 0.1 : -0.1};
    if (robot.loop.Apply(control) != PlantStatus::kOk) break;
  }
  EXPECT_LT(applied, 3);
  EXPECT_EQ(robot.loop.state(), RunState::kFaulted);
}

// An arm is calibrated to some per cent, and vision is as exact as its pixels.
TEST(ControlLoopTest, ErrorsOfCalibrationAndVisionAreNoReason) {
  for (const double scale : {0.85, 1.15}) {
    FakeRobot robot;
    robot.camera.scale = scale;
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    ASSERT_TRUE(robot.loop.Look());
    for (int i = 0; i < 400; ++i) {
      robot.camera.off = {i % 2 == 0 ? 0.1 : -0.1, i % 3 == 0 ? 0.1 : -0.1};
      ASSERT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk) << i << ": " << robot.loop.cause();
    }
  }
}

TEST(ControlLoopTest, ATargetThatMovesFasterThanItCanBeFollowedHolds) {
  for (const double jump : {-2.5, 2.5}) {
    FakeRobot robot({}, 3);
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    ASSERT_TRUE(robot.loop.Look());
    for (int i = 0; i < 10; ++i) {
      robot.camera.target += i % 2 == 0 ? 1.4 : -1.4;
      ASSERT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk) << robot.loop.cause();
    }
    robot.camera.target += jump;
    EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kFault);
    EXPECT_EQ(robot.loop.cause(), "state-jump: the line moves faster than the loop can follow");
    EXPECT_FALSE(robot.loop.ended_regularly());
  }
}

// -- starting -------------------------------------------------------------------------------------

TEST(ControlLoopTest, AReasonBeforeTheStartOnlyPreventsIt) {
  for (const Source& source : Sources()) {
    if (source.name == "period") continue;  // is over when it is found
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
    source.end(robot);
    EXPECT_EQ(robot.loop.Start(), HoldReason::kNone);
    EXPECT_TRUE(robot.arm.armed());
  }
}

TEST(ControlLoopTest, AnArmThatRefusesIsNotStarted) {
  FakeRobot robot;
  robot.arm.refuses_arm = {HoldReason::kArmJump, "frames disagree"};
  EXPECT_EQ(robot.loop.Start(), HoldReason::kArmJump);
  EXPECT_EQ(robot.loop.state(), RunState::kFaulted);
  EXPECT_EQ(robot.loop.cause(), "arm-jump: frames disagree");
}

TEST(ControlLoopTest, WaitsForReasonsToEndAsLongAsItHasPatience) {
  FakeRobot robot;
  robot.arm.found = {HoldReason::kArmInvalid, "stamped zero"};
  robot.clock.plan_ns = robot.clock.now_ns + 1'000'000'000;
  robot.clock.plan = [&] { robot.arm.found = {}; };
  EXPECT_EQ(robot.loop.Start(), HoldReason::kArmInvalid) << "no patience";
  EXPECT_EQ(robot.loop.Start(3.0), HoldReason::kNone);

  FakeRobot faulted;
  ASSERT_EQ(faulted.loop.Start(), HoldReason::kNone);
  faulted.loop.Hold(HoldReason::kArmSilent);
  const std::int64_t start_ns = faulted.clock.now_ns;
  EXPECT_EQ(faulted.loop.Start(3.0), HoldReason::kArmSilent);
  EXPECT_LT(faulted.clock.now_ns - start_ns, 500'000'000) << "time mends no fault";
}

// -- homing ---------------------------------------------------------------------------------------

// Before arming, only the encoders may report motion.
bool MattersForHoming(const Source& source) {
  return source.name != "camera" && source.name != "camera's thread hangs";
}

TEST(ControlLoopTest, HomesOnceAskedTo) {
  FakeRobot robot;
  robot.arm.unhomed = true;
  robot.camera.found = {HoldReason::kImageInvalid, "dark"};
  EXPECT_FALSE(robot.loop.AwaitReady(0.5, {}));
  EXPECT_TRUE(robot.loop.AwaitHomeable(0.5, {}));
  robot.loop.Idle(10.0);
  EXPECT_EQ(robot.arm.homings, 0) << "nobody has asked for it";
  EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
  EXPECT_EQ(robot.arm.homings, 1);
  EXPECT_FALSE(robot.arm.unhomed);
  robot.camera.found = {};
  EXPECT_EQ(robot.loop.Start(), HoldReason::kNone);
  EXPECT_EQ(robot.loop.Home(), HoldReason::kOperator) << "it is armed";
  robot.loop.Halt();
  EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
  EXPECT_EQ(robot.arm.homings, 1) << "there was no need to";
}

TEST(ControlLoopTest, DoesNotPowerUpWithAReasonToHold) {
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
    source.end(robot);
    EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
  }
}

TEST(ControlLoopTest, HomingEndsExactlyAtTheDeadlineOfEverythingItWatches) {
  for (const Source& source : Sources()) {
    if (!MattersForHoming(source)) continue;
    SCOPED_TRACE(source.name + ", " + runtime::Name(source.reason));
    FakeRobot robot;
    robot.arm.unhomed = true;
    robot.loop.Idle(0.5);
    const std::int64_t begins_ns = robot.clock.now_ns + 750'000'000;  // half a second into it
    robot.clock.plan_ns = begins_ns;
    robot.clock.plan = [&] { source.begin(robot); };
    EXPECT_EQ(robot.loop.Home(), source.reason);
    EXPECT_EQ(robot.arm.homings, 1);
    EXPECT_TRUE(robot.arm.unhomed);
    EXPECT_EQ(robot.arm.disabled_ns, robot.clock.now_ns) << "in the period that finds it";
    const int late = source.name == "period" ? 1 : 0;  // it is the next one that is late
    EXPECT_LE(robot.clock.now_ns - begins_ns,
              (source.periods() + late - 1) * kPeriodNs + (late != 0 ? 50'000'000 : 0));
    source.end(robot);
    robot.loop.Idle(5.0);
    EXPECT_TRUE(robot.arm.unhomed) << "it went on by itself";
    EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
  }
}

TEST(ControlLoopTest, AStopThatWasPressedWhileIdleIsKnownOnceCleared) {
  FakeRobot robot;
  robot.stop.found = {HoldReason::kEmergencyStop, "pressed"};
  robot.loop.Idle(0.3);
  EXPECT_FALSE(robot.loop.Clear());
  robot.stop.found = {};
  EXPECT_TRUE(robot.loop.Clear());
  EXPECT_EQ(robot.loop.state(), RunState::kIdle);
}

TEST(ControlLoopTest, WaitingEndsAtOnceWhenInterruptedOrStopped) {
  FakeRobot robot;
  robot.stop.found = {HoldReason::kEmergencyStopSilent, "is it running?"};
  robot.interrupted = true;
  std::int64_t start_ns = robot.clock.now_ns;
  EXPECT_FALSE(robot.loop.AwaitReady(10.0, {}));
  EXPECT_LT(robot.clock.now_ns - start_ns, 500'000'000);
  robot.interrupted = false;
  robot.stop.found = {HoldReason::kEmergencyStop, "pressed"};
  start_ns = robot.clock.now_ns;
  EXPECT_FALSE(robot.loop.AwaitReady(10.0, {}));
  EXPECT_LT(robot.clock.now_ns - start_ns, 500'000'000);
}

TEST(ControlLoopTest, SaysOnceWhatItWaitsFor) {
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

TEST(ControlLoopTest, EpisodesEndRegularlyWhenCompletedHaltedOrNotSeen) {
  FakeRobot robot;
  EXPECT_TRUE(robot.loop.ended_regularly());
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.loop.Complete();
  EXPECT_EQ(robot.loop.state(), RunState::kIdle);
  EXPECT_TRUE(robot.loop.ended_regularly());
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

TEST(ControlLoopTest, HaltTellsTheArmWhateverTheState) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.loop.Complete();
  EXPECT_TRUE(robot.arm.armed());
  robot.loop.Halt();
  EXPECT_FALSE(robot.arm.armed());
  robot.loop.Halt();
  EXPECT_FALSE(robot.arm.armed());
}

TEST(ControlLoopTest, ClearAcknowledgesTheEmergencyStop) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.stop.found = {HoldReason::kEmergencyStop, "pressed"};
  robot.loop.Tick();
  EXPECT_FALSE(robot.loop.Clear());
  EXPECT_EQ(robot.stop.acknowledged, 1);
  robot.stop.found = {};
  EXPECT_TRUE(robot.loop.Clear());
  EXPECT_EQ(robot.loop.state(), RunState::kIdle);
}

// -- the rest -------------------------------------------------------------------------------------

TEST(ControlLoopTest, InLockStepAMotionEndsWithTheSimulatorAtRest) {
  FakeRobot robot;
  robot.clock.in_lock_step = true;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
  EXPECT_EQ(robot.clock.rests, 1);
  robot.clock.at_rest = {HoldReason::kArmSilent, "it does not answer"};
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kFault);
  robot.clock.at_rest = {};
  robot.loop.Tick();
  ExpectHeldUntilStarted(robot, HoldReason::kArmSilent);
}

TEST(ControlLoopTest, TransitionsAreRecordedWithTheirCauses) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  EXPECT_EQ(robot.recorder.written, 2);  // armed, running
  robot.loop.Hold(HoldReason::kNotSeen, "no line");
  EXPECT_EQ(robot.recorder.written, 3);
  EXPECT_EQ(robot.recorder.last.from, RunState::kRunning);
  EXPECT_EQ(robot.recorder.last.to, RunState::kHolding);
  EXPECT_STREQ(robot.recorder.last.detail.data(), "no line");
  EXPECT_EQ(robot.recorder.last_wall_ns, robot.clock.WallNs());
}

TEST(ControlLoopTest, NeedsNeitherStopNorRecorder) {
  FakeRobot robot;
  ControlLoop loop(
      {}, {.clock = &robot.clock, .arm = &robot.arm, .camera = &robot.camera, .task = &robot.task});
  ASSERT_EQ(loop.Start(), HoldReason::kNone);
  EXPECT_EQ(loop.Apply(kControl), PlantStatus::kOk);
  EXPECT_FALSE((loop.Hold(HoldReason::kOperator), loop.Clear()));
}

TEST(ControlLoopTest, NeverAllocates) {
  FakeRobot robot;
  robot.clock.plan_ns = robot.clock.now_ns + 2'000'000'000;
  robot.clock.plan = [&] { robot.stop.found = {HoldReason::kEmergencyStop, "pressed"}; };
  const test::NoAlloc no_alloc;
  EXPECT_EQ(robot.loop.Start(1.0), HoldReason::kNone);
  control::Step step;
  step.mode = control::Mode::kRecovery;
  int applied = 0;
  for (; robot.loop.Apply(kControl) == PlantStatus::kOk; ++applied) robot.loop.Decided(step);
  EXPECT_GT(applied, 20);
  EXPECT_EQ(robot.loop.state(), RunState::kFaulted);
  robot.stop.found = {};
  EXPECT_TRUE(robot.loop.Clear());
  robot.arm.unhomed = true;
  EXPECT_EQ(robot.loop.Home(), HoldReason::kNone);
  EXPECT_EQ(robot.loop.Start(1.0), HoldReason::kNone);
  EXPECT_EQ(robot.loop.Apply(std::array{kNan, 0.0}), PlantStatus::kRefused);
  robot.loop.Hold(HoldReason::kNotSeen, "a detail that is longer than a short string can hold");
  robot.loop.Complete();
  robot.loop.Halt();
}

TEST(ControlLoopTest, ThrowsForOptionsOutOfRangeAndMissingDevices) {
  EXPECT_THROW(FakeRobot({.period_s = 0.0}), std::invalid_argument);
  EXPECT_THROW(FakeRobot({.max_period_s = 0.0}), std::invalid_argument);
  EXPECT_THROW(FakeRobot({.settle_time_s = -1.0}), std::invalid_argument);
  FakeRobot robot;
  EXPECT_THROW(ControlLoop({}, {.clock = &robot.clock}), std::invalid_argument);
}

TEST(ControlLoopTest, TheRecorderIsToldHowEachPeriodStands) {
  FakeRobot robot;
  robot.loop.Idle(0.5);
  const int periods = robot.recorder.periods;
  EXPECT_EQ(periods, 100);
  EXPECT_EQ(robot.recorder.last_arm, HoldReason::kNone);
  EXPECT_EQ(robot.recorder.last_stop, HoldReason::kNone);
  robot.arm.found = {HoldReason::kArmOld, "old"};
  robot.stop.found = {HoldReason::kEmergencyStop, "pressed"};
  robot.loop.Tick();
  EXPECT_EQ(robot.recorder.periods, periods + 1);
  EXPECT_EQ(robot.recorder.last_arm, HoldReason::kArmOld);
  EXPECT_EQ(robot.recorder.last_stop, HoldReason::kEmergencyStop);
  robot.arm.found = {};
  robot.stop.found = {};
  ASSERT_TRUE(robot.loop.Clear());
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.loop.Tick();
  EXPECT_EQ(robot.recorder.last_state, RunState::kRunning);
  robot.stop.hangs = true;
  robot.loop.Idle(0.2);
  EXPECT_EQ(robot.recorder.last_stop, HoldReason::kEmergencyStopSilent);
}

}  // namespace
}  // namespace dfr::robot
