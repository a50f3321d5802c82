// The console's statements of control, which reveal commands that only the console has received,
// and the ends of moves.
#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <vector>

#include "dfr/kinematics/psm.h"
#include "dfr/sim/dvrk/psm_console.h"
#include "tests/kinematics/psm_home.h"

namespace dfr::sim {
namespace {

using kinematics::PsmJoints;

class PsmConsoleControlTest : public testing::Test {
 protected:
  PsmConsoleControlTest() { console_.Place(test::PsmHome()); }
  // Returns the statements since the last call, in order.
  std::string Stated() {
    std::string all;
    for (const ConsoleMessage& message : console_.TakeMessages()) {
      const std::string begin = "PSM1: control ";
      if (message.text.starts_with(begin)) all += message.text.substr(begin.size()) + ' ';
    }
    return all;
  }
  void Servo() { console_.ServoCp(console_.setpoint_pose()); }

  PsmConsole console_{{.arm = "PSM1", .homing_s = 0.1}};
};

TEST_F(PsmConsoleControlTest, EachChangeIsStatedOnce) {
  struct Case {
    const char* command;
    std::function<void()> carry_out;
    std::string stated;
  };
  const PsmJoints still = PsmJoints::Zero();
  const Eigen::Isometry3d same = Eigen::Isometry3d::Identity();
  const std::vector<Case> cases = {
      {"hold", [&] { console_.Hold(); }, "JOINT_SPACE/POSITION_MODE "},
      {"free", [&] { console_.Free(); }, "JOINT_SPACE/EFFORT_MODE "},
      {"servo_jp", [&] { console_.ServoJp(console_.setpoint_joints()); },
       "JOINT_SPACE/POSITION_MODE "},
      {"servo_jr", [&] { console_.ServoJr(still); }, "JOINT_SPACE/POSITION_MODE "},
      {"servo_cr", [&] { console_.ServoCr(same); }, ""},
      {"move_jp", [&] { console_.MoveJp(console_.setpoint_joints()); },
       "JOINT_SPACE/TRAJECTORY_MODE "},
      {"move_jr", [&] { console_.MoveJr(still); }, "JOINT_SPACE/TRAJECTORY_MODE "},
      {"move_cp", [&] { console_.MoveCp(console_.setpoint_pose()); },
       "CARTESIAN_SPACE/TRAJECTORY_MODE "},
      {"jaw/servo_jp", [&] { console_.ServoJaw(0.0); }, ""},
      {"jaw/move_jp", [&] { console_.MoveJaw(0.0); }, "CARTESIAN_SPACE/TRAJECTORY_MODE "},
      {"servo_jf", [&] { console_.ServoEffort("servo_jf"); }, "JOINT_SPACE/EFFORT_MODE "},
      {"jaw/servo_jf", [&] { console_.ServoEffort("jaw/servo_jf"); },
       "CARTESIAN_SPACE/EFFORT_MODE "},
      {"body/servo_cf", [&] { console_.ServoEffort("body/servo_cf"); },
       "CARTESIAN_SPACE/EFFORT_MODE "},
      {"pause", [&] { console_.StateCommand("pause"); }, "UNDEFINED_SPACE/UNDEFINED_MODE "}};
  for (const Case& c : cases) {
    SCOPED_TRACE(c.command);
    Servo();
    (void)Stated();
    Servo();
    EXPECT_EQ(Stated(), "");
    c.carry_out();
    EXPECT_EQ(Stated(), c.stated);
    if (console_.state() == ArmState::kPaused) console_.StateCommand("resume");
    Servo();
    EXPECT_EQ(Stated(), c.stated.empty() ? "" : "CARTESIAN_SPACE/POSITION_MODE ");
  }
}

TEST_F(PsmConsoleControlTest, AJawCommandKeepsTheSpace) {
  console_.Hold();
  (void)Stated();
  console_.ServoJaw(0.1);
  EXPECT_EQ(Stated(), "");
  console_.MoveJaw(0.2);
  EXPECT_EQ(Stated(), "JOINT_SPACE/TRAJECTORY_MODE ");
}

TEST_F(PsmConsoleControlTest, DroppedCommandsChangeNothing) {
  Servo();
  console_.StateCommand("disable");
  EXPECT_EQ(Stated(), "CARTESIAN_SPACE/POSITION_MODE UNDEFINED_SPACE/UNDEFINED_MODE ");
  console_.Hold();
  console_.Free();
  Servo();
  EXPECT_EQ(Stated(), "");
}

TEST_F(PsmConsoleControlTest, HomingEndsWithoutControl) {
  PsmConsole console({.arm = "PSM1", .homing_s = 0.1});
  console.StateCommand("home");
  for (int i = 0; i < 200; ++i) console.Step(1e-3);
  std::string all;
  for (const ConsoleMessage& message : console.TakeMessages()) all += message.text + '\n';
  EXPECT_EQ(all,
            "PSM1: now ENABLED\nPSM1: control JOINT_SPACE/TRAJECTORY_MODE\n"
            "PSM1: control UNDEFINED_SPACE/UNDEFINED_MODE\nPSM1: homed\n");
}

TEST_F(PsmConsoleControlTest, AStopEndsEachMoveOnce) {
  PsmJoints turn = PsmJoints::Zero();
  turn[0] = 0.5;
  for (const auto stop : {&PsmConsole::Hold, &PsmConsole::Free}) {
    console_.MoveJr(turn);
    console_.MoveJaw(0.4);
    console_.Step(1e-3);
    (console_.*stop)();
    EXPECT_EQ(console_.TakeGoals(), std::vector<bool>({false, false}));
    const PsmJoints there = console_.setpoint_joints();
    for (int n = 0; n < 1000; ++n) console_.Step(1e-3);
    EXPECT_EQ(console_.setpoint_joints(), there);
  }
}

}  // namespace
}  // namespace dfr::sim
