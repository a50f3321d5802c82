#include "dfr/sim/dvrk/psm_console.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "tests/kinematics/psm_home.h"
#include "tests/support/all_close.h"

namespace dfr::sim {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;
using test::PsmHomeWith;
using testing::Contains;
using testing::ElementsAre;
using testing::Field;
using testing::HasSubstr;

constexpr double kDegree = 0.017453292519943295;

auto Says(ConsoleMessage::Severity severity, const std::string& text) {
  return Contains(testing::AllOf(Field(&ConsoleMessage::severity, severity),
                                 Field(&ConsoleMessage::text, HasSubstr(text))));
}
auto Warns(const std::string& text) { return Says(ConsoleMessage::Severity::kWarning, text); }
auto Errs(const std::string& text) { return Says(ConsoleMessage::Severity::kError, text); }

void Pass(PsmConsole& console, double seconds) {
  for (int i = 0; i < static_cast<int>(std::lround(1000.0 * seconds)); ++i) console.Step(1e-3);
}

PsmConsole Homed() {
  PsmConsole console({.arm = "PSM1", .homing_s = 0.1});
  console.StateCommand("home");
  Pass(console, 0.2);
  (void)console.TakeMessages();
  return console;
}

TEST(PsmConsoleTest, HomingGoesThroughBusyToHomed) {
  PsmConsole console({.arm = "PSM1", .homing_s = 0.5});
  EXPECT_EQ(console.state(), ArmState::kDisabled);
  EXPECT_FALSE(console.valid());
  console.StateCommand("home");
  EXPECT_EQ(console.state(), ArmState::kEnabled);
  EXPECT_TRUE(console.busy());
  Pass(console, 0.4);
  EXPECT_FALSE(console.homed());
  Pass(console, 0.2);
  EXPECT_TRUE(console.homed());
  EXPECT_TRUE(console.valid());
  EXPECT_FALSE(console.busy());
  EXPECT_TRUE(test::AllClose(console.measured_pose().translation(),
                             Eigen::Vector3d(0.0, 0.0, -0.1135), 1e-12));
}

TEST(PsmConsoleTest, CommandsWhenNotReadyAreDroppedWithAWarning) {
  PsmConsole console({.arm = "PSM1", .homing_s = 0.1});
  console.ServoJp(PsmHomeWith(0, 0.1));
  EXPECT_THAT(console.TakeMessages(), Warns("PSM1: servo_jp dropped, arm not ready: DISABLED"));
  console.StateCommand("enable");
  console.MoveCp(Psm::Forward(PsmHomeWith(0, 0.1)));
  EXPECT_THAT(console.TakeMessages(), Warns("move_cp dropped, arm not ready: not homed"));
  console.StateCommand("home");
  console.ServoCp(Psm::Forward(PsmHomeWith(0, 0.1)));
  EXPECT_THAT(console.TakeMessages(), Warns("arm not ready: homing"));
  Pass(console, 0.2);
  console.StateCommand("pause");
  console.MoveJaw(0.1);
  EXPECT_THAT(console.TakeMessages(), Warns("jaw/move_jp dropped, arm not ready: PAUSED"));
  Pass(console, 0.5);
  EXPECT_EQ(console.measured_joints(), test::PsmHome());
  console.StateCommand("resume");
  console.ServoJp(PsmHomeWith(0, 0.01));
  EXPECT_THAT(console.TakeMessages(), testing::Not(Warns("dropped")));
}

// The table lists the state after each command in each state.
TEST(PsmConsoleTest, StateCommandsFollowTheTable) {
  struct Row {
    const char* command;
    ArmState from_disabled, from_enabled, from_paused, from_fault;
  };
  const auto d = ArmState::kDisabled;
  const auto e = ArmState::kEnabled;
  const auto p = ArmState::kPaused;
  const auto f = ArmState::kFault;
  for (const Row& row :
       {Row{"enable", e, e, p, f}, Row{"disable", d, d, d, d}, Row{"pause", d, p, p, f},
        Row{"resume", d, e, e, f}, Row{"home", e, e, e, f}, Row{"unhome", d, d, d, d},
        Row{"dance", d, e, p, f}}) {
    SCOPED_TRACE(row.command);
    PsmConsole disabled = Homed();
    disabled.StateCommand("disable");
    PsmConsole enabled = Homed();
    PsmConsole paused = Homed();
    paused.StateCommand("pause");
    PsmConsole fault = Homed();
    fault.Fail("a cable is off");
    for (PsmConsole* console : {&disabled, &enabled, &paused, &fault}) {
      console->StateCommand(row.command);
    }
    EXPECT_EQ(disabled.state(), row.from_disabled);
    EXPECT_EQ(enabled.state(), row.from_enabled);
    EXPECT_EQ(paused.state(), row.from_paused);
    EXPECT_EQ(fault.state(), row.from_fault);
    EXPECT_EQ(enabled.homed(), std::string(row.command) != "unhome");
  }
}

TEST(PsmConsoleTest, AnEnableWithoutEffectIsDroppedWithAWarning) {
  PsmConsole homing({.homing_s = 1.0});
  homing.StateCommand("home");
  PsmConsole paused = Homed();
  paused.StateCommand("pause");
  for (PsmConsole* console : {&homing, &paused}) {
    (void)console->TakeMessages();
    console->StateCommand("enable");
    EXPECT_THAT(console->TakeMessages(), Warns("cannot enable"));
  }
}

TEST(PsmConsoleTest, FaultStopsTheArmAndReportsTheReason) {
  PsmConsole console = Homed();
  console.MoveJp(PsmHomeWith(0, 0.5));
  Pass(console, 0.2);
  console.Fail("encoder of joint 2 lost");
  EXPECT_THAT(console.TakeMessages(), Errs("PSM1: encoder of joint 2 lost"));
  EXPECT_THAT(console.TakeGoals(), ElementsAre(false));
  Pass(console, 0.2);  // ten time constants of the lag
  const PsmJoints rest = console.measured_joints();
  console.ServoJp(test::PsmHome());
  console.StateCommand("enable");
  EXPECT_THAT(console.TakeMessages(), Warns("ignored in FAULT"));
  Pass(console, 0.5);
  EXPECT_TRUE(test::AllClose(console.measured_joints(), rest, 1e-5));
  console.StateCommand("disable");
  console.StateCommand("enable");
  EXPECT_EQ(console.state(), ArmState::kEnabled);
}

// A console has no timeout for old commands.
TEST(PsmConsoleTest, LastServoGoalIsHeldIndefinitely) {
  PsmConsole console = Homed();
  console.ServoJp(PsmHomeWith(1, 0.2));
  Pass(console, 20.0);
  EXPECT_TRUE(test::AllClose(console.measured_joints(), PsmHomeWith(1, 0.2), 1e-9));
  EXPECT_FALSE(console.busy());
}

TEST(PsmConsoleTest, JointsKeepTheirSpeedLimitsForAnyGoal) {
  core::Random random(1);
  PsmConsole console = Homed();
  PsmJoints before = console.setpoint_joints();
  for (int step = 0; step < 6000; ++step) {
    if (step % 500 == 0) {
      PsmJoints goal;
      for (int i = 0; i < 6; ++i) {
        goal[i] = random.Uniform(Psm::lower_limits()[i], Psm::upper_limits()[i]);
      }
      step % 1000 == 0 ? console.ServoJp(goal) : console.MoveJp(goal);
    }
    console.Step(1e-3);
    const PsmJoints speed = (console.setpoint_joints() - before).cwiseAbs() / 1e-3;
    before = console.setpoint_joints();
    for (int i = 0; i < 6; ++i) {
      // Rounding errors of joint values, 1e-16, are divided by a millisecond.
      ASSERT_LE(speed[i], (i == 2 ? 0.2 : 90 * kDegree) + 1e-11);
    }
  }
}

// The tip does not move on a straight line.
TEST(PsmConsoleTest, MoveInterpolatesInJointSpaceAndReportsTheGoal) {
  PsmConsole console = Homed();
  const PsmJoints from = console.setpoint_joints();
  PsmJoints goal = PsmHomeWith(0, 0.6);
  goal[1] = -0.3;
  goal[2] = 0.18;
  console.MoveCp(Psm::Forward(goal));
  EXPECT_TRUE(console.busy());
  double furthest = 0.0;
  while (console.busy()) {
    console.Step(1e-3);
    const PsmJoints q = console.setpoint_joints();
    const double share = (q[0] - from[0]) / (goal[0] - from[0]);
    ASSERT_TRUE(test::AllClose(q, from + share * (goal - from), 1e-9));
    const Eigen::Vector3d a = Psm::Forward(from).translation();
    const Eigen::Vector3d b = Psm::Forward(goal).translation();
    const Eigen::Vector3d p = console.setpoint_pose().translation();
    furthest = std::max(furthest, (p - a).cross((b - a).normalized()).norm());
  }
  EXPECT_GT(furthest, 1e-3);
  EXPECT_THAT(console.TakeGoals(), ElementsAre(true));
  EXPECT_TRUE(test::AllClose(console.setpoint_joints(), goal, 1e-12));
}

TEST(PsmConsoleTest, AnotherCommandEndsAMove) {
  PsmConsole console = Homed();
  console.MoveJp(PsmHomeWith(0, 0.5));
  Pass(console, 0.1);
  console.MoveJp(PsmHomeWith(0, -0.1));
  EXPECT_THAT(console.TakeGoals(), ElementsAre(false));
  Pass(console, 5.0);
  EXPECT_THAT(console.TakeGoals(), ElementsAre(true));
}

// sawIntuitiveResearchKit's clip_jp clips every goal in this way. The tip does not reach a clipped
// goal.
TEST(PsmConsoleTest, GoalsBeyondLimitsAreClippedAndNamedOnce) {
  PsmConsole console = Homed();
  console.ServoJp(PsmHomeWith(2, 0.3));
  EXPECT_THAT(console.TakeMessages(), Warns("servo_jp clipped at the limits of insertion (0.3)"));
  console.ServoJp(PsmHomeWith(2, 0.31));
  EXPECT_THAT(console.TakeMessages(), testing::IsEmpty());
  Pass(console, 2.0);
  EXPECT_EQ(console.setpoint_joints(), PsmHomeWith(2, Psm::upper_limits()[2]));
  console.ServoJp(PsmHomeWith(2, 0.2));
  console.MoveJp(PsmHomeWith(5, -2.0));
  EXPECT_THAT(console.TakeMessages(), Warns("move_jp clipped at the limits of wrist yaw (-2)"));
  Pass(console, 3.0);
  EXPECT_EQ(console.setpoint_joints(), PsmHomeWith(5, Psm::lower_limits()[5]));
  EXPECT_THAT(console.TakeGoals(), ElementsAre(true));
  console.ServoJp(test::PsmHome());
  console.MoveCp(Psm::Forward(PsmHomeWith(0, 95 * kDegree)));
  EXPECT_THAT(console.TakeMessages(), Warns("move_cp clipped at the limits of yaw"));
  Pass(console, 3.0);
  EXPECT_NEAR(console.setpoint_joints()[0], 91 * kDegree, 1e-9);
  console.ServoJaw(81 * kDegree);
  EXPECT_THAT(console.TakeMessages(), Warns("jaw/servo_jp clipped at the jaw's limits"));
  Pass(console, 3.0);
  EXPECT_NEAR(console.setpoint_jaw(), 80 * kDegree, 1e-12);
}

TEST(PsmConsoleTest, AnSiArmHasItsOwnLimitsAndInstrument) {
  PsmConsole console({.homing_s = 0.1, .generation = kinematics::PsmGeneration::kSi});
  EXPECT_STREQ(console.tool(), "LARGE_NEEDLE_DRIVER:420006[1]");
  console.StateCommand("home");
  Pass(console, 0.2);
  (void)console.TakeMessages();
  console.ServoJp(PsmHomeWith(2, 0.29));
  console.ServoCp(Psm::Forward(PsmHomeWith(0, 2.9)));
  EXPECT_THAT(console.TakeMessages(), testing::Not(Warns("clipped")));
  Pass(console, 3.0);
  EXPECT_NEAR(console.setpoint_joints()[0], 2.9, 1e-9);
  console.ServoJp(PsmHomeWith(2, 0.3));
  EXPECT_THAT(console.TakeMessages(), Warns("servo_jp clipped at the limits of insertion (0.3)"));
  console.ServoJaw(-21 * kDegree);
  EXPECT_THAT(console.TakeMessages(), Warns("jaw/servo_jp clipped at the jaw's limits"));
}

TEST(PsmConsoleTest, GoalsWithoutJointValuesAreDropped) {
  PsmConsole console = Homed();
  Eigen::Isometry3d broken = Eigen::Isometry3d::Identity();
  broken.translation().x() = std::numeric_limits<double>::quiet_NaN();
  console.ServoCp(broken);
  EXPECT_THAT(console.TakeMessages(), Errs("servo_cp dropped, inverse kinematics failed"));
  console.MoveCp(broken);
  EXPECT_THAT(console.TakeMessages(), Errs("move_cp dropped, inverse kinematics failed"));
  EXPECT_THAT(console.TakeGoals(), ElementsAre(false));
  console.ServoJp(PsmJoints::Constant(std::numeric_limits<double>::quiet_NaN()));
  EXPECT_THAT(console.TakeMessages(), Errs("servo_jp dropped"));
  console.MoveJaw(std::numeric_limits<double>::quiet_NaN());
  EXPECT_THAT(console.TakeMessages(), Errs("jaw/move_jp dropped"));
  Pass(console, 1.0);
  EXPECT_EQ(console.measured_joints(), test::PsmHome());
  EXPECT_EQ(console.measured_jaw(), 0.0);
}

TEST(PsmConsoleTest, MovesTakeLongerAtASmallerRatio) {
  const auto duration = [](double ratio) {
    PsmConsole console = Homed();
    console.SetTrajectoryRatio(ratio);
    console.MoveJp(PsmHomeWith(0, 0.5));
    int steps = 0;
    for (; console.busy(); ++steps) console.Step(1e-3);
    return 1e-3 * steps;
  };
  // The top speed is 1.5 times the mean speed, and at most 90 degrees/s.
  EXPECT_NEAR(duration(1.0), 1.5 * 0.5 / (90 * kDegree), 2e-3);
  EXPECT_NEAR(duration(0.25), 4.0 * 1.5 * 0.5 / (90 * kDegree), 2e-3);
  PsmConsole console = Homed();
  console.SetTrajectoryRatio(0.0);
  EXPECT_THAT(console.TakeMessages(), Warns("trajectory_j/set_ratio is ignored"));
  EXPECT_EQ(console.trajectory_ratio(), 1.0);
}

// A cart's poses are relative to its camera.
TEST(PsmConsoleTest, PosesAreInTheGivenFrameAndInvalidOptionsAreRefused) {
  PsmConsoleOptions options{.arm = "PSM1", .homing_s = 0.0};
  options.base_frame.translation() = Eigen::Vector3d(0.1, 0.2, -0.3);
  options.base_frame.linear() =
      Eigen::AngleAxisd(1.2, Eigen::Vector3d(1.0, 2.0, 3.0).normalized()).toRotationMatrix();
  PsmConsole console(options);
  console.StateCommand("home");
  Pass(console, 0.01);
  PsmJoints goal = PsmHomeWith(0, 0.2);
  goal[4] = -0.3;
  console.ServoCp(options.base_frame * Psm::Forward(goal));
  for (int i = 0; i < 50; ++i) console.Step(1e-3);
  // During motion the twist is the derivative of the pose.
  const Eigen::Vector3d before = console.measured_pose().translation();
  console.Step(1e-3);
  EXPECT_TRUE(test::AllClose((console.measured_pose().translation() - before) / 1e-3,
                             console.measured_twist().head<3>(), 1e-3));
  EXPECT_GT(console.measured_twist().head<3>().norm(), 0.1);
  Pass(console, 2.0);
  EXPECT_TRUE(test::AllClose(console.setpoint_joints(), goal, 1e-9));
  EXPECT_TRUE(test::AllClose(console.measured_pose().matrix(),
                             (options.base_frame * Psm::Forward(goal)).matrix(), 1e-9));
  options.base_frame.linear() *= 2.0;
  EXPECT_THROW(PsmConsole{options}, std::invalid_argument);
  EXPECT_THROW(PsmConsole({.arm = ""}), std::invalid_argument);
  EXPECT_THROW(PsmConsole({.arm = "PSM1", .homing_s = -1.0}), std::invalid_argument);
  EXPECT_THROW(PsmConsole({.arm = "PSM1", .homing_s = 1.0, .lag_s = 0.0}), std::invalid_argument);
}

TEST(PsmConsoleTest, RelativeGoalsAddUp) {
  PsmConsole console = Homed();
  PsmJoints step = PsmJoints::Zero();
  step[0] = 0.01;
  console.ServoJr(step);
  console.ServoJr(step);  // before the arm reaches the first goal
  Pass(console, 0.5);
  EXPECT_EQ(console.setpoint_joints(), PsmHomeWith(0, 0.02));
  console.MoveJr(step);
  Pass(console, 0.001);
  console.MoveJr(step);  // during the motion: relative to its goal
  EXPECT_THAT(console.TakeGoals(), ElementsAre(false));
  Pass(console, 2.0);
  EXPECT_NEAR(console.setpoint_joints()[0], 0.04, 1e-15);
  EXPECT_THAT(console.TakeGoals(), ElementsAre(true));
  step[2] = 0.2;
  console.ServoJr(step);
  EXPECT_THAT(console.TakeMessages(), Warns("servo_jr clipped at the limits of insertion"));
  console.ServoJr(PsmJoints::Constant(std::numeric_limits<double>::quiet_NaN()));
  EXPECT_THAT(console.TakeMessages(), Errs("servo_jr dropped"));
}

TEST(PsmConsoleTest, RelativePosesAreInTheBaseFrame) {
  PsmConsole console = Homed();
  const Eigen::Isometry3d from = console.setpoint_pose();
  Eigen::Isometry3d difference = Eigen::Isometry3d::Identity();
  difference.translation() = Eigen::Vector3d(0.003, -0.002, 0.001);
  difference.linear() = Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitX()).toRotationMatrix();
  console.ServoCr(difference);
  Pass(console, 0.5);
  const Eigen::Isometry3d to = console.setpoint_pose();
  EXPECT_TRUE(
      test::AllClose(to.translation(), from.translation() + difference.translation(), 1e-12));
  EXPECT_TRUE(test::AllClose(to.linear(), difference.linear() * from.linear(), 1e-12));
  difference.translation().x() = std::numeric_limits<double>::quiet_NaN();
  console.ServoCr(difference);
  EXPECT_THAT(console.TakeMessages(), Errs("servo_cr dropped"));
}

TEST(PsmConsoleTest, FreeGivesUpTheGoalAndEffortsAreRefused) {
  PsmConsole console = Homed();
  console.MoveJp(PsmHomeWith(0, 0.5));
  Pass(console, 0.2);
  const PsmJoints there = console.measured_joints();
  console.Free();
  EXPECT_THAT(console.TakeGoals(), ElementsAre(false));
  EXPECT_FALSE(console.busy());
  Pass(console, 1.0);
  EXPECT_EQ(console.measured_joints(), there);
  console.ServoEffort("servo_jf");
  EXPECT_THAT(console.TakeMessages(), Errs("PSM1: servo_jf dropped, the simulated arm has no"));
  console.StateCommand("disable");
  console.Free();
  console.ServoEffort("servo_jf");
  EXPECT_THAT(console.TakeMessages(), Warns("servo_jf dropped, arm not ready: DISABLED"));
}

TEST(PsmConsoleTest, TwistIsThatOfTheWristInTheBaseFrame) {
  PsmConsole console = Homed();
  EXPECT_EQ(console.measured_twist(), (Eigen::Matrix<double, 6, 1>::Zero()));
  for (int i = 1; i <= 600; ++i) {
    console.ServoJp(PsmHomeWith(0, -0.2 + 1e-3 * i));
    console.Step(1e-3);
  }
  // A tool that points down and turns by 1 rad/s about -y moves towards +x, once the lag has
  // settled (to exp(-20)).
  const Eigen::Vector3d wrist = console.measured_pose().translation();
  EXPECT_NEAR(wrist.norm(), 0.1135, 1e-12);
  const Eigen::Vector3d turn = -Eigen::Vector3d::UnitY();
  Eigen::Matrix<double, 6, 1> expected;
  expected << turn.cross(wrist), turn;
  EXPECT_TRUE(test::AllClose(console.measured_twist(), expected, 1e-7));
}

TEST(PsmConsoleTest, PlaceHomesTheArmAndSettleEndsItsMotions) {
  PsmConsole console({.arm = "PSM1"});
  console.Place(PsmHomeWith(1, 0.3));
  EXPECT_EQ(console.state(), ArmState::kEnabled);
  EXPECT_TRUE(console.homed());
  EXPECT_EQ(console.measured_joints(), PsmHomeWith(1, 0.3));
  console.MoveJp(PsmHomeWith(1, 0.1));
  console.MoveJaw(0.4);
  Pass(console, 0.01);
  console.Settle();
  EXPECT_EQ(console.measured_joints(), PsmHomeWith(1, 0.1));
  EXPECT_EQ(console.setpoint_joints(), PsmHomeWith(1, 0.1));
  EXPECT_EQ(console.measured_jaw(), 0.4);
  EXPECT_FALSE(console.busy());
  EXPECT_THAT(console.TakeGoals(), ElementsAre(true, true));
  Pass(console, 0.5);
  EXPECT_EQ(console.measured_joints(), PsmHomeWith(1, 0.1));
  EXPECT_THROW(console.Place(PsmHomeWith(2, 0.3)), std::invalid_argument);
}

TEST(PsmConsoleTest, JawOpensAtItsSpeed) {
  PsmConsole console = Homed();
  console.MoveJaw(45 * kDegree);
  Pass(console, 0.4);
  EXPECT_NEAR(console.setpoint_jaw(), 36 * kDegree, 1e-9);
  EXPECT_TRUE(console.busy());
  Pass(console, 0.6);
  EXPECT_NEAR(console.measured_jaw(), 45 * kDegree, 1e-6);
  EXPECT_THAT(console.TakeGoals(), ElementsAre(true));
}

}  // namespace
}  // namespace dfr::sim
