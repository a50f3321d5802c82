// A guard whose caller reports the applied actions.

#include <gtest/gtest.h>

#include <limits>
#include <vector>

#include "dfr/safety/guard.h"
#include "dfr/safety/guard_advice.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"

// A separate namespace, because sources are compiled together.
namespace dfr::safety::shadow_tests {
namespace {

using control::HaltCause;
using test::Action;
using test::CorridorPlant;
using test::Model;

const std::vector<double> kAhead = Action(0.0997, 0.0);
const std::vector<double> kAside = Action(0.05, 0.3);

TEST(ShadowTest, LookingAtChunksAndReportingTheGuardsActionChangeNothing) {
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kController, Strategy::kMonitor,
                                  Strategy::kDfr, Strategy::kEarlyStopping}) {
    Guard told(Model(strategy));
    Guard blind(Model(strategy));
    told.Reset(1);
    blind.Reset(1);
    CorridorPlant plant;
    std::vector<double> safe(2);
    std::vector<double> expected(2);
    const std::vector<double> bad = {0.1, std::numeric_limits<double>::quiet_NaN()};
    for (int t = 0; t < 30; ++t) {
      const std::vector<double> action = Action(0.09, t % 3 == 0 ? 0.06 : -0.02);
      const std::vector<double> chunk = {action[0], action[1], action[0], action[1]};
      static_cast<void>(told.FilterChunk(t, plant.x, chunk));
      static_cast<void>(told.FilterChunk(t, plant.x, bad));
      static_cast<void>(told.FilterChunk(t + 1, plant.x, action));
      const Verdict verdict = told.Filter(t, plant.x, action, safe);
      told.Applied(safe);
      ASSERT_EQ(verdict.mode, blind.Filter(t, plant.x, action, expected).mode) << t;
      ASSERT_EQ(safe, expected) << t;
      plant.Apply(safe);
    }
  }
}

TEST(ShadowTest, TheLastReportCounts) {
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kController}) {
    for (const bool as_chosen : {true, false}) {
      Guard corrected(Model(strategy));
      Guard told(Model(strategy));
      corrected.Reset(1);
      told.Reset(1);
      CorridorPlant plant;
      std::vector<double> safe(2);
      std::vector<double> expected(2);
      for (int t = 0; t < 30; ++t) {
        const std::vector<double> action = Action(0.09, t % 3 == 0 ? 0.06 : -0.02);
        const Verdict verdict = corrected.Filter(t, plant.x, action, safe);
        const Verdict same = told.Filter(t, plant.x, action, expected);
        ASSERT_EQ(verdict.mode, same.mode) << t;
        ASSERT_EQ(verdict.level, same.level) << t;
        ASSERT_EQ(safe, expected) << t;
        const std::vector<double> applied = as_chosen ? safe : Action(0.08, 0.01);
        corrected.Applied(std::vector<double>{-safe[0], -safe[1]});
        corrected.Applied(applied);
        if (!as_chosen) told.Applied(applied);
        plant.Apply(applied);
      }
    }
  }
}

// A report in wrong units would outweigh all measurements of the response. A report of a huge
// action would overflow in the estimate, and the resulting NaN could let actions pass.
TEST(ShadowTest, AnActionThatNothingCanHaveAppliedHalts) {
  for (const double size : {1.0, 99.7, 1e80, 1e155, 1e200, std::numeric_limits<double>::max()}) {
    Guard guard(Model());
    guard.Reset(1);
    std::vector<double> safe(2);
    CorridorPlant plant;
    ASSERT_NE(guard.Filter(0, plant.x, kAhead, safe).mode, control::Mode::kHalt);
    guard.Applied(std::vector<double>{size, -size});
    plant.Apply(kAhead);
    const Verdict verdict = guard.Filter(1, plant.x, kAhead, safe);
    EXPECT_EQ(verdict.mode, control::Mode::kHalt) << size;
    EXPECT_EQ(verdict.cause, HaltCause::kControlInvalid) << size;
  }
}

// A policy may exceed the limits, and a robot without limits applies the policy's action.
TEST(ShadowTest, GoesOnAfterAnActionBeyondTheLimitsThatARobotCanHaveApplied) {
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kController, Strategy::kMonitor}) {
    Guard guard(Model(strategy));
    const std::vector<double> beyond = Action(2.0 * guard.model().settings().action_limit[0], 0.0);
    guard.Reset(1);
    std::vector<double> safe(2);
    const CorridorPlant plant;
    static_cast<void>(guard.Filter(0, plant.x, beyond, safe));
    guard.Applied(beyond);
    EXPECT_EQ(guard.Filter(1, plant.x, kAhead, safe).cause, HaltCause::kNone);
  }
}

// The state of the guard after an action does not depend on the source of the action.
TEST(ShadowTest, ContinuesFromTheAppliedAction) {
  Guard told(Model());
  Guard asked(Model());
  told.Reset(1);
  asked.Reset(1);
  CorridorPlant plant;
  std::vector<double> safe(2);
  std::vector<double> expected(2);
  for (int t = 0; t < 3; ++t) {
    ASSERT_FALSE(asked.Filter(t, plant.x, kAhead, expected).changed) << t;
    ASSERT_TRUE(told.Filter(t, plant.x, kAside, safe).changed) << t;
    told.Applied(kAhead);
    plant.Apply(kAhead);
  }
  for (int t = 3; t < 20; ++t) {
    const std::vector<double> action = Action(0.09, t % 3 == 0 ? 0.06 : -0.02);
    const Verdict verdict = told.Filter(t, plant.x, action, safe);
    const Verdict same = asked.Filter(t, plant.x, action, expected);
    ASSERT_EQ(verdict.step, same.step) << t;
    ASSERT_EQ(safe, expected) << t;
    plant.Apply(safe);
  }
}

TEST(ShadowTest, CountsTheActionsThatPass) {
  Guard guard(Model());
  int actions = 0;
  int passed = 0;
  for (const core::Trajectory& episode : test::CorridorDemonstrations(7, 20)) {
    const Shadow shadow = RunInShadow(guard, episode);
    EXPECT_EQ(shadow.actions, 20);
    EXPECT_EQ(shadow.halted, -1);
    EXPECT_EQ(shadow.micros.size(), 20U);
    EXPECT_EQ(shadow.first_changed < 0, shadow.passed == shadow.actions);
    actions += shadow.actions;
    passed += shadow.passed;
  }
  // An action passes if its predicted level is at least the .05 quantile of demonstrated levels.
  EXPECT_GT(passed, 0.8 * actions);
  EXPECT_LT(passed, actions);
}

// An episode that leaves the corridor at step 8 and does not return.
TEST(ShadowTest, NamesTheFirstActionThatLeaves) {
  core::Trajectory episode = test::CorridorDemonstrations(7, 1)[0];
  CorridorPlant plant;
  for (int t = 0; t < 20; ++t) {
    const std::vector<double>& action = t < 8 ? kAhead : kAside;
    episode.states.row(t) << plant.x[0], plant.x[1], plant.x[2];
    episode.controls.row(t) << action[0], action[1];
    plant.Apply(action);
  }
  episode.states.row(20) << plant.x[0], plant.x[1], plant.x[2];
  Guard guard(Model());
  const Shadow shadow = RunInShadow(guard, episode);
  EXPECT_EQ(shadow.first_changed, 8);
  EXPECT_EQ(shadow.reason, "demonstrations");
  EXPECT_EQ(shadow.passed, 8);
  EXPECT_GT(shadow.change, 0.0);
  // Algorithm 1 cannot continue after an action that it did not choose.
  Guard published(Model(Strategy::kDfr));
  const Shadow first = RunInShadow(published, episode);
  EXPECT_GE(first.first_changed, 0);
  EXPECT_LE(first.halted, first.first_changed + 1);
}

TEST(ShadowTest, HaltsAfterAnActionThatItCannotContinueFrom) {
  std::vector<double> safe(2);
  const CorridorPlant plant;
  const auto cause = [&](Strategy strategy, const std::vector<double>& applied) {
    Guard guard(Model(strategy));
    guard.Reset(1);
    static_cast<void>(guard.Filter(0, plant.x, kAhead, safe));
    guard.Applied(applied);
    return guard.Filter(1, plant.x, kAhead, safe).cause;
  };
  EXPECT_EQ(cause(Strategy::kGuard, {0.1}), HaltCause::kControlInvalid);
  EXPECT_EQ(cause(Strategy::kGuard, {0.1, std::numeric_limits<double>::quiet_NaN()}),
            HaltCause::kControlInvalid);
  EXPECT_EQ(cause(Strategy::kMonitor, {0.1, std::numeric_limits<double>::infinity()}),
            HaltCause::kControlInvalid);
  EXPECT_EQ(cause(Strategy::kDfr, kAside), HaltCause::kStepSkipped);
  EXPECT_EQ(cause(Strategy::kMonitor, kAside), HaltCause::kNone);
  Guard early(Model());
  early.Reset(1);
  early.Applied(kAhead);
  EXPECT_EQ(early.Filter(0, plant.x, kAhead, safe).cause, HaltCause::kStepSkipped);
  core::Trajectory narrow = test::CorridorDemonstrations(7, 1)[0];
  narrow.controls.conservativeResize(Eigen::NoChange, 1);
  EXPECT_THROW(static_cast<void>(RunInShadow(early, narrow)), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::safety::shadow_tests
