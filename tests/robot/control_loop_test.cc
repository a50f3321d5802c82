#include "dfr/robot/control_loop.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "tests/robot/control_loop_faults.h"
#include "tests/robot/fake_robot.h"
#include "tests/support/no_alloc.h"

namespace dfr::robot {
namespace {

using core::PlantStatus;
using runtime::HoldReason;
using runtime::RunState;
using test::ExpectHeldUntilStarted;
using test::FakeRobot;
using test::kControl;
using test::kNan;
using test::kPeriodNs;
using testing::HasSubstr;

// -- controls -------------------------------------------------------------------------------------

TEST(ControlLoopTest, AControlMovesTheArmAndIsObservedAtRest) {
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
  // A control takes five periods of motion, three until rest and four until the picture.
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

TEST(ControlLoopTest, AControlThatTheTaskOrTheArmRefusesIsRefused) {
  for (const bool by_the_arm : {false, true}) {
    FakeRobot robot;
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    robot.task.unreachable = !by_the_arm;
    if (by_the_arm) robot.arm.refuses_motion = {HoldReason::kCommandRefused, "too fast"};
    EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kRefused);
    EXPECT_EQ(robot.loop.cause() == "command-refused: too fast", by_the_arm);
    robot.task.unreachable = false;
    robot.arm.refuses_motion = {};
    robot.loop.Halt();
    ExpectHeldUntilStarted(robot, HoldReason::kCommandRefused);
  }
}

TEST(ControlLoopTest, AJumpOfTheStateHolds) {
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

TEST(ControlLoopTest, PicturesWithoutAStateAreRetried) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  robot.camera.unseen = 2;
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
  EXPECT_EQ(robot.camera.questions, 3);
  EXPECT_NEAR(robot.loop.observation()[0], 0.3, 1e-12);
  // The state is then NaN, and a controller halts. This is not a fault of a device.
  robot.camera.unseen = 3;
  EXPECT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
  EXPECT_EQ(robot.camera.questions, 6);
  EXPECT_TRUE(std::isnan(robot.loop.observation()[0]));
}

TEST(ControlLoopTest, TheControllersDecisionsDetermineTheState) {
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

// -- current pictures -------------------------------------------------------------------

// Applies controls of `size` mm until the loop holds. Returns the distance that the tip moved, mm.
double WayUntilHeld(FakeRobot& robot, double size, int most = 100) {
  const std::array<double, 2> begin = robot.arm.at;
  const std::array control = {0.6 * size, 0.8 * size};
  for (int i = 0; i < most && robot.loop.Apply(control) == PlantStatus::kOk; ++i) {
  }
  return 1e3 * std::hypot(robot.arm.at[0] - begin[0], robot.arm.at[1] - begin[1]);
}

TEST(ControlLoopTest, PicturesThatDoNotShowTheMotionHold) {
  for (const double size : {0.05, 0.5, 2.8}) {
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

TEST(ControlLoopTest, LatePicturesWithFreshStampsHold) {
  for (const double size : {0.5, 1.0, 2.0, 2.8}) {
    SCOPED_TRACE(size);
    FakeRobot robot;
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    ASSERT_TRUE(robot.loop.Look());
    for (int i = 0; i < 10; ++i) ASSERT_EQ(robot.loop.Apply(kControl), PlantStatus::kOk);
    robot.camera.pictures_late = 6;  // 2 s if a control takes a third of a second
    EXPECT_LT(WayUntilHeld(robot, size), 3.0);
    EXPECT_EQ(robot.loop.state(), RunState::kFaulted) << robot.loop.cause();
  }
}

TEST(ControlLoopTest, UncommandedMotionHolds) {
  FakeRobot robot;
  ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
  ASSERT_TRUE(robot.loop.Look());
  int applied = 0;
  // The observed tool drifts by 0.2 mm with each control of 0.1 mm forwards or backwards.
  for (; applied < 100; ++applied) {
    robot.camera.off[0] += 0.2;
    const std::array control = {0.0, applied % 2 == 0 ? 0.1 : -0.1};
    if (robot.loop.Apply(control) != PlantStatus::kOk) break;
  }
  EXPECT_LT(applied, 3);
  EXPECT_EQ(robot.loop.state(), RunState::kFaulted);
}

// The calibration of an arm has errors of several per cent, and vision is accurate to a pixel.
TEST(ControlLoopTest, ErrorsOfCalibrationAndVisionDoNotHold) {
  for (const double scale : {0.85, 1.15}) {
    FakeRobot robot;
    robot.camera.scale = scale;
    ASSERT_EQ(robot.loop.Start(), HoldReason::kNone);
    ASSERT_TRUE(robot.loop.Look());
    for (int i = 0; i < 200; ++i) {
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

// -- other properties -----------------------------------------------------------------------------

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
  EXPECT_THROW(FakeRobot({.max_images = 0}), std::invalid_argument);
  // A comparison with a limit that is not a number never finds a fault.
  using Options = ControlLoopOptions;
  for (double Options::*const limit :
       {&Options::image_latency_s, &Options::image_timeout_s, &Options::max_camera_check_s,
        &Options::max_stop_check_s, &Options::max_state_jump, &Options::max_drift,
        &Options::drift_noise, &Options::drift_share, &Options::drift_stretch,
        &Options::max_target_jump}) {
    for (const double wrong : {kNan, -1.0, HUGE_VAL}) {
      Options options;
      options.*limit = wrong;
      EXPECT_THROW((FakeRobot(options)), std::invalid_argument) << wrong;
    }
  }
  FakeRobot robot;
  EXPECT_THROW(ControlLoop({}, {.clock = &robot.clock}), std::invalid_argument);
}

TEST(ControlLoopTest, TheRecorderGetsTheStateOfEachPeriod) {
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
