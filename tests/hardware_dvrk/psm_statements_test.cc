#include "dfr/hardware/psm_statements.h"

#include <gtest/gtest.h>

#include <cstdint>

namespace dfr::hardware {
namespace {

constexpr std::int64_t kMillisecond = 1'000'000;

TEST(PsmStatementsTest, WithoutCommandsAnyStatementIsAnothers) {
  PsmStatements statements;
  EXPECT_TRUE(statements.Take(0, 0, 0));
  EXPECT_FALSE(statements.Take(0, 1, 0));
  EXPECT_FALSE(statements.Take(1, 0, 0));
}

TEST(PsmStatementsTest, EachCommandHasOneAnswer) {
  PsmStatements statements;
  statements.Armed(0);
  EXPECT_TRUE(statements.Take(1, 0, 5000 * kMillisecond))
      << "the first set-point's, whenever it is obeyed";
  EXPECT_FALSE(statements.Take(1, 0, 5000 * kMillisecond));
  EXPECT_FALSE(statements.Take(0, 1, 5000 * kMillisecond));
  statements.Held(5000 * kMillisecond);
  statements.Held(5010 * kMillisecond);
  EXPECT_TRUE(statements.Take(0, 1, 5020 * kMillisecond));
  EXPECT_FALSE(statements.Take(0, 1, 5020 * kMillisecond));
}

TEST(PsmStatementsTest, AnswersComeAfterTheNextCommands) {
  PsmStatements statements;
  for (int i = 0; i < 5; ++i) {
    statements.Armed(i * 100 * kMillisecond);
    statements.Unsettle();
    statements.Held(i * 100 * kMillisecond + 50 * kMillisecond);
  }
  for (int i = 0; i < 5; ++i) EXPECT_TRUE(statements.Take(1, 1, 500 * kMillisecond)) << i;
  EXPECT_FALSE(statements.Take(1, 0, 500 * kMillisecond));
  EXPECT_FALSE(statements.Take(0, 1, 500 * kMillisecond));
}

TEST(PsmStatementsTest, NoAnswerToAHoldComesAfterThatOfALaterSetpointOrASecond) {
  PsmStatements statements;
  statements.Held(0);
  statements.Armed(0);
  statements.JawMoved(0);
  EXPECT_TRUE(statements.Take(1, 0, 10 * kMillisecond));
  EXPECT_FALSE(statements.Take(0, 1, 10 * kMillisecond));
  statements.JawMoved(20 * kMillisecond);
  EXPECT_FALSE(statements.Take(0, 1, 20 * kMillisecond))
      << "in the space of poses the jaw changes none";
  statements.Held(30 * kMillisecond);
  EXPECT_FALSE(statements.Take(0, 1, 31 * kMillisecond + PsmStatements::kLongest));
}

TEST(PsmStatementsTest, AStateCommandHasOneToo) {
  PsmStatements statements;
  statements.Held(0);
  EXPECT_TRUE(statements.Take(0, 1, 0));
  statements.Requested(0);
  EXPECT_TRUE(statements.Take(0, 1, 0));
  statements.Held(0);
  EXPECT_TRUE(statements.Take(0, 1, 0)) << "the control was no longer that of the hold";
}

// Forgotten answers are taken for another's: the safe side.
TEST(PsmStatementsTest, MoreHoldsThanItRemembers) {
  PsmStatements statements;
  for (int i = 0; i < 100; ++i) {
    statements.Unsettle();
    statements.Held(0);
  }
  EXPECT_TRUE(statements.Take(0, 16, 0));
  EXPECT_FALSE(statements.Take(0, 1, 0));
}

}  // namespace
}  // namespace dfr::hardware
