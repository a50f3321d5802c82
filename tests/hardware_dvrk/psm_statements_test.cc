#include "dfr/hardware/psm_statements.h"

#include <gtest/gtest.h>

#include <cstdint>

#include "dfr/hardware/control_statement.h"

namespace dfr::hardware {
namespace {

constexpr std::int64_t kMillisecond = 1'000'000;

TEST(PsmStatementsTest, WithoutCommandsEveryStatementIsForeign) {
  PsmStatements statements;
  EXPECT_TRUE(statements.Take(0, 0, 0));
  EXPECT_FALSE(statements.Take(0, 1, 0));
  EXPECT_FALSE(statements.Take(1, 0, 0));
}

TEST(PsmStatementsTest, EachCommandHasOneAnswer) {
  PsmStatements statements;
  statements.Armed();
  EXPECT_TRUE(statements.Take(1, 0, 5000 * kMillisecond))
      << "answers the first set-point, at any time";
  EXPECT_FALSE(statements.Take(1, 0, 5000 * kMillisecond));
  EXPECT_FALSE(statements.Take(0, 1, 5000 * kMillisecond));
  statements.Held(5000 * kMillisecond);
  EXPECT_TRUE(statements.awaits());
  EXPECT_TRUE(statements.Take(0, 1, 5020 * kMillisecond));
  EXPECT_FALSE(statements.awaits());
  EXPECT_FALSE(statements.Take(0, 1, 5020 * kMillisecond));
}

// The answer to a set-point sent before the hold arrives late, together with or before the answer
// to the hold.
TEST(PsmStatementsTest, AnswersFromBeforeTheHoldDoNotAnswerTheNextSetpoint) {
  for (const bool together : {false, true}) {
    SCOPED_TRACE(together);
    PsmStatements statements;
    statements.Armed();
    statements.Held(0);
    statements.Armed();
    if (together) {
      EXPECT_TRUE(statements.Take(1, 1, 900 * kMillisecond));
    } else {
      EXPECT_TRUE(statements.Take(1, 0, 800 * kMillisecond));
      EXPECT_TRUE(statements.awaits());
      EXPECT_TRUE(statements.Take(0, 1, 900 * kMillisecond));
    }
    EXPECT_FALSE(statements.awaits());
    EXPECT_TRUE(statements.Take(1, 0, 1000 * kMillisecond));
    EXPECT_FALSE(statements.Take(1, 0, 1000 * kMillisecond));
  }
}

// The order of messages within a tick is unknown: the hold may have arrived after the set-point.
TEST(PsmStatementsTest, AHoldTogetherWithTheAnswerToASetpointIsForeign) {
  PsmStatements statements;
  statements.Armed();
  EXPECT_FALSE(statements.Take(1, 1, 0));
}

TEST(PsmStatementsTest, AnUnansweredHoldIsAwaitedForASecond) {
  PsmStatements statements;
  statements.Held(0);
  statements.Armed();
  EXPECT_TRUE(statements.Take(0, 0, PsmStatements::kLongest));
  EXPECT_TRUE(statements.awaits());
  EXPECT_TRUE(statements.Take(0, 0, PsmStatements::kLongest + 1));
  EXPECT_FALSE(statements.awaits());
  EXPECT_FALSE(statements.Take(0, 1, PsmStatements::kLongest + 1));
}

TEST(PsmStatementsTest, AHoldThatChangesNothingIsNotAwaited) {
  PsmStatements statements;
  statements.Held(0);
  EXPECT_TRUE(statements.Take(0, 1, 0));
  statements.Held(0);
  EXPECT_FALSE(statements.awaits());
  statements.Unsettle();
  statements.Held(0);
  EXPECT_TRUE(statements.awaits()) << "the control was no longer that of the hold";
}

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
