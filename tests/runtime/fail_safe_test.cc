#include "dfr/runtime/fail_safe.h"

#include <gtest/gtest.h>

#include <array>
#include <set>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/no_alloc.h"

namespace dfr::runtime {
namespace {

constexpr std::int64_t kPeriod = 10'000'000;  // ns

// A machine and its loop's clock.
struct Loop {
  FailSafe machine{FailSafeOptions{.max_period_s = 0.05, .settle_time_s = 0.1}};
  std::int64_t now_ns = 1'000'000'000;

  void Tick(int periods = 1) {
    for (int i = 0; i < periods; ++i) {
      now_ns += kPeriod;
      machine.Tick(now_ns);
    }
  }
  void Bring(RunState state) {
    Tick();
    if (state == RunState::kIdle) return;
    ASSERT_TRUE(machine.Arm());
    if (state == RunState::kFaulted) return machine.Hold(HoldReason::kArmSilent);
    if (state == RunState::kHolding) return machine.Hold(HoldReason::kOperator);
    if (state == RunState::kArmed) return;
    ASSERT_TRUE(machine.Start());
    machine.Recovering(state == RunState::kRecovering);
  }
};

constexpr std::array kAllStates = {RunState::kIdle,       RunState::kArmed,   RunState::kRunning,
                                   RunState::kRecovering, RunState::kHolding, RunState::kFaulted};
static_assert(kAllStates.size() == static_cast<std::size_t>(RunState::kFaulted) + 1);

TEST(FailSafeTest, EveryReasonStopsMotionInEveryState) {
  for (const RunState state : kAllStates) {
    for (int d = 1; d < kNumHoldReasons; ++d) {
      const auto reason = static_cast<HoldReason>(d);
      SCOPED_TRACE(std::string(Name(state)) + ", " + Name(reason));
      Loop loop;
      loop.Bring(state);
      ASSERT_EQ(loop.machine.state(), state);
      loop.machine.Hold(reason);
      EXPECT_FALSE(loop.machine.may_move());
      if (state == RunState::kIdle) {
        EXPECT_EQ(loop.machine.state(), RunState::kIdle) << "there is nothing to stop";
      } else if (IsFault(reason) || state == RunState::kFaulted) {
        EXPECT_EQ(loop.machine.state(), RunState::kFaulted);
      } else {
        EXPECT_EQ(loop.machine.state(), RunState::kHolding);
      }
      EXPECT_FALSE(loop.machine.Arm()) << "while the reason lasts";
    }
  }
}

TEST(FailSafeTest, OnlyAnOperatorMakesItMoveAgain) {
  for (int d = 1; d < kNumHoldReasons; ++d) {
    const auto reason = static_cast<HoldReason>(d);
    SCOPED_TRACE(Name(reason));
    Loop loop;
    loop.Bring(RunState::kRunning);
    loop.machine.Hold(reason);
    // The reason disappeared long ago.
    for (int i = 0; i < 1000; ++i) {
      loop.Tick();
      loop.machine.Recovering(i % 2 == 0);
      loop.machine.Done();
      ASSERT_FALSE(loop.machine.may_move());
    }
    EXPECT_FALSE(loop.machine.Start()) << "it has to be armed first";
    if (IsFault(reason)) {
      EXPECT_FALSE(loop.machine.Arm()) << "a fault has to be cleared first";
      EXPECT_TRUE(loop.machine.Clear());
    }
    EXPECT_TRUE(loop.machine.Arm());
    EXPECT_TRUE(loop.machine.Start());
    EXPECT_TRUE(loop.machine.may_move());
  }
}

TEST(FailSafeTest, IsArmedOnlyAfterATimeWithoutReasonToHold) {
  Loop loop;
  EXPECT_FALSE(loop.machine.Arm()) << "its loop does not run yet";
  loop.Tick();
  loop.machine.Hold(HoldReason::kNotSeen, "no line");
  EXPECT_EQ(loop.machine.state(), RunState::kIdle);
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(loop.machine.blocking(), HoldReason::kNotSeen);
    EXPECT_EQ(loop.machine.blocking_detail(), "no line");
    EXPECT_FALSE(loop.machine.Arm());
    loop.Tick();
  }
  loop.Tick();  // 0.11 s later
  EXPECT_EQ(loop.machine.blocking(), HoldReason::kNone);
  EXPECT_EQ(loop.machine.blocking_detail(), "");
  EXPECT_TRUE(loop.machine.Arm());
}

TEST(FailSafeTest, AFaultCannotBeClearedWhileItLasts) {
  Loop loop;
  loop.Bring(RunState::kRunning);
  for (int i = 0; i < 100; ++i) {
    loop.Tick();
    loop.machine.Hold(HoldReason::kEmergencyStop);
    ASSERT_FALSE(loop.machine.Clear());
  }
  loop.Tick(11);
  EXPECT_TRUE(loop.machine.Clear());
  EXPECT_EQ(loop.machine.state(), RunState::kIdle);
}

TEST(FailSafeTest, ALateLoopIsAFault) {
  Loop loop;
  loop.Bring(RunState::kRunning);
  loop.Tick(100);
  EXPECT_TRUE(loop.machine.may_move());
  loop.machine.Tick(loop.now_ns + 50'000'000);
  EXPECT_TRUE(loop.machine.may_move()) << "just within the limit";
  loop.machine.Tick(loop.now_ns + 100'000'001);
  EXPECT_EQ(loop.machine.state(), RunState::kFaulted);

  Loop backwards;
  backwards.Bring(RunState::kRunning);
  backwards.machine.Tick(backwards.now_ns - 1);
  EXPECT_EQ(backwards.machine.state(), RunState::kFaulted);
}

TEST(FailSafeTest, LogsEveryTransitionWithItsCause) {
  Loop loop;
  loop.Bring(RunState::kRunning);
  loop.machine.Recovering(true);
  loop.machine.Recovering(true);  // no change
  loop.machine.Recovering(false);
  loop.Tick();
  loop.machine.Hold(HoldReason::kControllerHalted, "no-progress");
  loop.machine.Hold(HoldReason::kArmSilent, std::string(200, 'x'));
  loop.machine.Hold(HoldReason::kImageOld, "too late to matter");

  struct Expected {
    RunState from, to;
    HoldReason reason;
    std::string detail;
  };
  const std::vector<Expected> expected = {
      {RunState::kIdle, RunState::kArmed, HoldReason::kNone, ""},
      {RunState::kArmed, RunState::kRunning, HoldReason::kNone, ""},
      {RunState::kRunning, RunState::kRecovering, HoldReason::kNone, ""},
      {RunState::kRecovering, RunState::kRunning, HoldReason::kNone, ""},
      {RunState::kRunning, RunState::kHolding, HoldReason::kControllerHalted, "no-progress"},
      {RunState::kHolding, RunState::kFaulted, HoldReason::kArmSilent, std::string(95, 'x')},
  };
  for (const Expected& e : expected) {
    Transition t;
    ASSERT_TRUE(loop.machine.Take(t));
    EXPECT_EQ(t.from, e.from);
    EXPECT_EQ(t.to, e.to);
    EXPECT_EQ(t.reason, e.reason);
    EXPECT_EQ(t.detail.data(), e.detail);
    EXPECT_LE(t.steady_ns, loop.now_ns);
  }
  Transition none;
  EXPECT_FALSE(loop.machine.Take(none));
}

TEST(FailSafeTest, AnUnreadLogLosesTheNewestEntries) {
  Loop loop;
  loop.Bring(RunState::kRunning);  // two transitions
  for (int i = 0; i < 100; ++i) loop.machine.Recovering(i % 2 == 0);
  int taken = 0;
  Transition t;
  while (loop.machine.Take(t)) ++taken;
  EXPECT_EQ(taken, 64);
}

TEST(FailSafeTest, EveryReasonAndStateHasADistinctName) {
  std::set<std::string> names;
  for (int i = 0; i < kNumHoldReasons; ++i) names.insert(Name(static_cast<HoldReason>(i)));
  EXPECT_EQ(names.size(), static_cast<std::size_t>(kNumHoldReasons));
  EXPECT_EQ(names.count("?"), 0U);
  std::set<std::string> states;
  for (const RunState state : kAllStates) states.insert(Name(state));
  EXPECT_EQ(states.size(), kAllStates.size());
}

TEST(FailSafeTest, ThrowsForOptionsOutOfRange) {
  EXPECT_THROW(FailSafe({.max_period_s = 0.0, .settle_time_s = 0.1}), std::invalid_argument);
  EXPECT_THROW(FailSafe({.max_period_s = 0.1, .settle_time_s = -1.0}), std::invalid_argument);
}

TEST(FailSafeTest, NeverAllocates) {
  Loop loop;
  Transition t;
  const test::NoAlloc no_alloc;
  loop.Bring(RunState::kRecovering);
  loop.machine.Hold(HoldReason::kArmJump, "a detail that is longer than a short string can hold");
  loop.Tick(20);
  ASSERT_TRUE(loop.machine.Clear());
  while (loop.machine.Take(t)) {
  }
}

}  // namespace
}  // namespace dfr::runtime
