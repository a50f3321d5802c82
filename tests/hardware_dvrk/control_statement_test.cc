#include "dfr/hardware/control_statement.h"

#include <gtest/gtest.h>

namespace dfr::hardware {
namespace {

TEST(ControlStatementTest, ParsesTheConsolesStatements) {
  EXPECT_EQ(ControlStatedBy("PSM1: control CARTESIAN_SPACE/POSITION_MODE"), PsmControl::kPoses);
  EXPECT_EQ(ControlStatedBy("PSM1: control UNDEFINED_SPACE/UNDEFINED_MODE"), PsmControl::kNone);
  for (const char* text :
       {"PSM1: control JOINT_SPACE/POSITION_MODE", "PSM1: control JOINT_SPACE/EFFORT_MODE",
        "PSM1: control JOINT_SPACE/TRAJECTORY_MODE", "PSM1: control CARTESIAN_SPACE/EFFORT_MODE",
        "PSM1: control CARTESIAN_SPACE/TRAJECTORY_MODE", "PSM1: control USER_SPACE/USER_MODE",
        "PSM1: control /"}) {
    EXPECT_EQ(ControlStatedBy(text), PsmControl::kOther) << text;
  }
  for (const char* text : {"", "PSM1: now ENABLED", "PSM1: control", "PSM1: control ", "/",
                           "PSM1: control loop is slow", "controls JOINT_SPACE/POSITION_MODE"}) {
    EXPECT_EQ(ControlStatedBy(text), PsmControl::kUnstated) << text;
  }
}

}  // namespace
}  // namespace dfr::hardware
