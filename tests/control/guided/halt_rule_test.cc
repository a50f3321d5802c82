#include "dfr/control/guided/halt_rule.h"

#include <gtest/gtest.h>

namespace dfr::control {
namespace {

constexpr HaltRule kRule{.horizon = 10, .max_controls = 50, .patience = 4};

TEST(HaltRuleTest, EachLimitIsReachedExactlyAndTimeComesFirst) {
  EXPECT_EQ(kRule({}), HaltCause::kNone);
  EXPECT_EQ(kRule({.time = 9.999, .controls = 49, .waited = 3}), HaltCause::kNone);
  EXPECT_EQ(kRule({.time = 10.0}), HaltCause::kTimeUp);
  EXPECT_EQ(kRule({.time = 10.5}), HaltCause::kTimeUp);
  EXPECT_EQ(kRule({.controls = 50}), HaltCause::kIterationLimit);
  EXPECT_EQ(kRule({.controls = 51}), HaltCause::kIterationLimit);
  EXPECT_EQ(kRule({.waited = 4}), HaltCause::kNoProgress);
  EXPECT_EQ(kRule({.waited = 5}), HaltCause::kNoProgress);
  EXPECT_EQ(kRule({.waited = 3, .away = 3}), HaltCause::kNone);
  EXPECT_EQ(kRule({.away = 4}), HaltCause::kNoProgress);
  // The horizon takes precedence over limits that are reached at the same time.
  EXPECT_EQ(kRule({.time = 10.0, .controls = 50, .waited = 4}), HaltCause::kTimeUp);
  EXPECT_EQ(kRule({.time = 10.0, .waited = 4}), HaltCause::kTimeUp);
  EXPECT_EQ(kRule({.time = 9.0, .controls = 50, .waited = 4}), HaltCause::kIterationLimit);
  EXPECT_EQ(kRule({.controls = 50, .away = 4}), HaltCause::kIterationLimit);
}

}  // namespace
}  // namespace dfr::control
