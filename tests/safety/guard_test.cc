#include "dfr/safety/guard.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "dfr/control/guided/guided_controller.h"
#include "dfr/control/published/switching_controller.h"
#include "dfr/core/random.h"
#include "dfr/safety/guard_model.h"
#include "tests/safety/corridor.h"
#include "tests/safety/corridor_guard.h"
#include "tests/support/no_alloc.h"

namespace dfr::safety {
namespace {

using control::HaltCause;
using control::Mode;
using test::Action;
using test::CorridorPlant;
using test::Model;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A policy that drifts sideways leaves the demonstrated corridor. With the guard it stays inside
// and reaches the end.
TEST(GuardTest, KeepsADriftingPolicyInsideAndMoving) {
  const std::vector<double> action = Action(0.09, 0.06);
  CorridorPlant alone;
  for (int t = 0; t < 20; ++t) alone.Apply(action);
  ASSERT_GT(alone.x[2], 1.0);

  Guard guard(Model());
  guard.Reset(1);
  CorridorPlant plant;
  std::vector<double> safe(2);
  int changed = 0;
  int t = 0;
  for (; plant.x[1] < 1.8 && t < 80; ++t) {
    const Verdict verdict = guard.Filter(t, plant.x, action, safe);
    ASSERT_NE(verdict.mode, Mode::kHalt) << verdict.reason() << " at x = " << plant.x[1];
    changed += verdict.changed ? 1 : 0;
    plant.Apply(safe);
    // Five standard deviations of the demonstrated positions.
    ASSERT_LT(std::abs(plant.x[2]), 0.5);
  }
  EXPECT_GE(plant.x[1], 1.8);
  EXPECT_GT(changed, 0);
}

// One feature is the same in all demonstrations at each time step, as in examples/fit_a_guard.cc.
// The estimated response of such a feature is noise, which must not stop the corrections of the
// other feature.
TEST(GuardTest, KeepsADriftingPolicyInsideWhereOneFeatureNeverVaries) {
  core::StateLayout layout;
  layout.Add("tip", 2);
  struct Case {
    double spread;  // Standard deviation of demonstrated states.
    double noise;   // Standard deviation of the sideways actions.
    std::vector<double> action;
  };
  // Without a guard, the policy ends 12 or 18 standard deviations away.
  for (const auto& [spread, noise, action] :
       {Case{0.1, 0.05, {0.09, 0.06}}, Case{0.03, 0.01, {0.1, 0.03}}}) {
    for (std::uint64_t seed = 1; seed <= 6; ++seed) {
      SCOPED_TRACE(testing::Message() << "spread " << spread << ", seed " << seed);
      core::Random random(seed);
      std::vector<core::Trajectory> demonstrations(30);
      for (core::Trajectory& demonstration : demonstrations) {
        demonstration.states.resize(21, 2);
        demonstration.controls.resize(20, 2);
        demonstration.states.row(0) << 0.0, spread * random.Normal();
        for (Eigen::Index t = 0; t < 20; ++t) {
          const double y = demonstration.states(t, 1);
          demonstration.controls.row(t) << 0.1, -0.3 * y + noise * random.Normal();
          demonstration.states.row(t + 1) =
              demonstration.states.row(t) + demonstration.controls.row(t);
        }
      }
      Guard guard(GuardModel::Fit(layout, demonstrations, {.features = "tip"}));
      guard.Reset(1);
      std::vector<double> tip = {0.0, 0.0};
      std::vector<double> safe(2);
      for (int t = 0; t < 40 && tip[0] < 1.8; ++t) {
        const Verdict verdict = guard.Filter(t, tip, action, safe);
        ASSERT_NE(verdict.mode, Mode::kHalt) << verdict.reason();
        for (int k = 0; k < 2; ++k) tip[k] += safe[k];
        ASSERT_LT(std::abs(tip[1]), 5.0 * spread) << "step " << t;
      }
      EXPECT_GE(tip[0], 1.8);
    }
  }
}

// The guard decides as the controller of its strategy with a policy that requests the action.
TEST(GuardTest, IsTheControllerOfItsStrategy) {
  const std::vector<double> action = Action(0.09, 0.04);
  for (const Strategy strategy :
       {Strategy::kGuard, Strategy::kController, Strategy::kDfr, Strategy::kEarlyStopping}) {
    SCOPED_TRACE(Name(strategy));
    const auto model = Model(strategy);
    const ActionSpace& actions = model->actions();
    const bool steers = strategy == Strategy::kGuard || strategy == Strategy::kController;
    std::vector<double> asked = action;
    if (steers) actions.Measure(action, asked);
    const test::ConstantPolicy policy(asked);
    std::unique_ptr<control::Controller> direct;
    if (steers) {
      direct = std::make_unique<control::GuidedController>(
          policy, model->task().view(),
          control::GuidedOptions{
              .horizon = 40,
              .max_controls = 480,
              .control_limit = actions.MeasuredLimits(model->settings().action_limit),
              .least_intervention = strategy == Strategy::kGuard});
    } else {
      direct = std::make_unique<control::SwitchingController>(
          policy, model->support(), model->lambda(),
          control::SwitchingControllerOptions{.recovery = strategy == Strategy::kDfr
                                                              ? control::Recovery::kDfr
                                                              : control::Recovery::kEarlyStopping,
                                              .horizon = 40});
    }
    ASSERT_EQ(model->settings().horizon, 40);
    Guard guard(model);
    guard.Reset(7);
    direct->Reset(7);
    CorridorPlant plant;
    std::vector<double> safe(2);
    std::vector<double> expected(2);
    for (int t = 0; t < 100; ++t) {
      const control::Step step = direct->Next(plant.x, expected);
      const Verdict verdict = guard.Filter(t, plant.x, action, safe);
      ASSERT_EQ(verdict.mode, step.mode) << "t = " << t;
      ASSERT_EQ(verdict.cause, step.cause);
      if (steers && verdict.changed) actions.Restore(std::vector(expected), expected);
      ASSERT_EQ(safe, steers && !verdict.changed ? action : expected);
      plant.Apply(safe);
    }
  }
}

// Also tests strategies whose controllers do not count actions.
TEST(GuardTest, HaltsAfterTheLargestNumberOfActions) {
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kController, Strategy::kDfr,
                                  Strategy::kMonitor, Strategy::kCertified}) {
    SCOPED_TRACE(Name(strategy));
    GuardSettings settings = Model(strategy)->settings();
    settings.max_actions = 3;
    Guard guard(Model()->With(settings));
    guard.Reset(1);
    if (strategy == Strategy::kMonitor) {
      CorridorPlant plant;
      std::vector<double> chunk;
      for (int i = 0; i < 5; ++i) {
        for (const double u : Action(test::kSpeed, 0.0)) chunk.push_back(u);
      }
      EXPECT_EQ(guard.FilterChunk(0, plant.x, chunk).playable, 3);
    }
    CorridorPlant plant;
    std::vector<double> safe(2);
    for (int t = 0; t < 5; ++t) {
      const Verdict verdict = guard.Filter(t, plant.x, Action(test::kSpeed, 0.0), safe);
      EXPECT_STREQ(Name(verdict.cause), t < 3 ? "none" : "iteration-limit") << "t = " << t;
      plant.Apply(safe);
    }
  }
}

TEST(GuardTest, AMonitorPassesEverythingAndRaisesAlarms) {
  Guard guard(Model(Strategy::kMonitor));
  guard.Reset();
  CorridorPlant plant;
  const std::vector<double> action = Action(0.1, 0.1);
  std::vector<double> safe(2);
  int first_alarm = -1;
  for (int t = 0; t < 20; ++t) {
    const Verdict verdict = guard.Filter(t, plant.x, action, safe);
    ASSERT_EQ(verdict.mode, Mode::kPolicy);
    ASSERT_EQ(safe, action);
    EXPECT_STREQ(verdict.reason(), verdict.g >= 0.0 ? "inside" : "outside");
    if (verdict.alarm && first_alarm < 0) first_alarm = t;
    // Once outside, the policy continues to drift away, and the alarm remains.
    if (first_alarm >= 0) {
      EXPECT_TRUE(verdict.alarm) << "t = " << t;
      EXPECT_LT(verdict.g, 0.0);
    }
    plant.Apply(safe);
  }
  EXPECT_GT(first_alarm, 1);
  EXPECT_LT(first_alarm, 10);
}

// A call after three valid ones, and the halt that it causes.
struct Doubt {
  const char* name;
  HaltCause cause;
  int t = 3;
  std::vector<double> state = {3.0, 0.3, 0.0};
  std::vector<double> action = Action(0.1, 0.0);
  std::size_t room = 2;  // Size of the result.
};

std::vector<Doubt> Doubts() {
  using enum HaltCause;
  return {
      {.name = "NaN in a feature", .cause = kStateInvalid, .state = {3.0, kNaN, 0.0}},
      {.name = "NaN in no feature", .cause = kStateInvalid, .state = {kNaN, 0.3, 0.0}},
      {.name = "infinite state", .cause = kStateInvalid, .state = {3.0, 0.3, -kInfinity}},
      {.name = "short state", .cause = kStateInvalid, .state = {0.3, 0.0}},
      {.name = "long state", .cause = kStateInvalid, .state = {3.0, 0.3, 0.0, 0.0}},
      {.name = "no state", .cause = kStateInvalid, .state = {}},
      {.name = "NaN action", .cause = kControlInvalid, .action = {0.1, kNaN}},
      {.name = "infinite action", .cause = kControlInvalid, .action = {kInfinity, 0.0}},
      {.name = "short action", .cause = kControlInvalid, .action = {0.1}},
      {.name = "no action", .cause = kControlInvalid, .action = {}},
      {.name = "a step twice", .cause = kStepSkipped, .t = 2},
      {.name = "a step left out", .cause = kStepSkipped, .t = 4},
      {.name = "a negative step", .cause = kStepSkipped, .t = -1},
      {.name = "a step far away", .cause = kStepSkipped, .t = std::numeric_limits<int>::max()},
      {.name = "no room for the result", .cause = kControlInvalid, .room = 1},
      {.name = "too much room for the result", .cause = kControlInvalid, .room = 1000},
  };
}

// The actions of a policy that stays inside pass unchanged to the bit, although many states of the
// corridor are not deep inside. With strategy `controller`, the guard changes some of the actions.
TEST(GuardTest, PassesAPolicyThatStaysInside) {
  int changed = 0;
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kController}) {
    Guard guard(Model(strategy));
    guard.Reset(1);
    CorridorPlant plant;
    std::vector<double> safe(2);
    for (int t = 0; t < 20; ++t) {
      const std::vector<double> action = Action(0.0997, 0.0003);
      const Verdict verdict = guard.Filter(t, plant.x, action, safe);
      if (strategy == Strategy::kGuard) {
        ASSERT_FALSE(verdict.changed) << t;
        ASSERT_EQ(safe, action);
        EXPECT_EQ(verdict.mode, Mode::kPolicy);
        EXPECT_EQ(verdict.source, Source::kPolicy);
        EXPECT_EQ(verdict.change, 0.0);
        // Decision() computes g from its logarithm, which causes rounding.
        EXPECT_NEAR(verdict.g, guard.model().support().Decision(verdict.step, plant.x), 1e-15);
        // The start is deep inside.
        EXPECT_TRUE(t > 0 || (verdict.g >= verdict.threshold && !verdict.alarm));
        EXPECT_TRUE(t > 0 || verdict.reason() == std::string("inside"));
      }
      changed += verdict.changed ? 1 : 0;
      plant.Apply(safe);
    }
  }
  EXPECT_GT(changed, 0);
}

// Demonstrations of the corridor with each action entry rescaled, and a gripper that closes after
// half of the steps.
std::vector<core::Trajectory> WithGripper(const std::vector<double>& scale) {
  std::vector<core::Trajectory> demonstrations = test::CorridorDemonstrations(1, 30);
  for (core::Trajectory& d : demonstrations) {
    core::Matrix actions(d.controls.rows(), 3);
    for (Eigen::Index t = 0; t < actions.rows(); ++t) {
      actions.row(t) << scale[0] * d.controls(t, 0), scale[1] * d.controls(t, 1),
          t < actions.rows() / 2 ? 1.0 : -1.0;
    }
    d.controls = actions;
  }
  return demonstrations;
}

// The units of an action's entries have no effect, and the gripper keeps the policy's value.
TEST(GuardTest, UnitsOfEntriesDoNotMatterAndThePolicySetsTheGripper) {
  for (const std::vector<double>& scale : {std::vector{1.0, 1.0}, std::vector{1024.0, 0.0078125}}) {
    Guard guard(GuardModel::Fit(test::CorridorLayout(), WithGripper(scale), {.features = "tip"}));
    ASSERT_EQ(guard.model().actions().steered_dim(), 2);
    EXPECT_FALSE(guard.model().actions().entries()[2].steered);
    EXPECT_THAT(Warnings(guard.model()),
                testing::Contains(testing::HasSubstr("closes: 2 (-1, 1).")));
    Guard plain(Model());
    guard.Reset(1);
    plain.Reset(1);
    CorridorPlant plant;
    std::vector<double> safe(3);
    std::vector<double> expected(2);
    int replaced = 0;
    for (int t = 0; t < 40; ++t) {
      const std::vector<double> action = Action(0.09, 0.06);
      const double gripper = t < 10 ? 1.0 : -1.0;
      const Verdict verdict = guard.Filter(
          t, plant.x, std::vector{scale[0] * action[0], scale[1] * action[1], gripper}, safe);
      const Verdict without = plain.Filter(t, plant.x, action, expected);
      ASSERT_EQ(verdict.mode, without.mode) << t;
      ASSERT_NEAR(safe[0] / scale[0], expected[0], 1e-9) << t;
      ASSERT_NEAR(safe[1] / scale[1], expected[1], 1e-9) << t;
      ASSERT_NEAR(verdict.change, without.change, 1e-9) << t;
      if (verdict.mode != Mode::kHalt) {
        ASSERT_EQ(safe[2], gripper);
      }
      replaced += verdict.source == Source::kDemonstrations ? 1 : 0;
      plant.Apply(expected);
    }
    EXPECT_GT(replaced, 0);
  }
}

TEST(GuardTest, PublishedRecoveriesLeaveTheGripperToThePolicy) {
  Guard guard(GuardModel::Fit(test::CorridorLayout(), WithGripper({1.0, 1.0}),
                              {.features = "tip", .strategy = Strategy::kDfr}));
  ASSERT_FALSE(guard.model().actions().entries()[2].steered);
  guard.Reset(1);
  CorridorPlant plant;
  std::vector<double> safe(3);
  int replaced = 0;
  for (int t = 0; t < 200; ++t) {
    const double gripper = t % 20 < 10 ? 1.0 : -1.0;
    const Verdict verdict = guard.Filter(t, plant.x, std::vector{0.09, 0.06, gripper}, safe);
    if (verdict.mode == Mode::kHalt) break;
    ASSERT_EQ(safe[2], gripper) << t;
    replaced += verdict.mode == Mode::kPolicy ? 0 : 1;
    plant.Apply({safe[0], safe[1]});
  }
  EXPECT_GT(replaced, 0);
}

TEST(GuardTest, EveryInvalidCallHaltsUntilReset) {
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kDfr, Strategy::kEarlyStopping,
                                  Strategy::kMonitor, Strategy::kController}) {
    for (const Doubt& doubt : Doubts()) {
      SCOPED_TRACE(testing::Message() << Name(strategy) << ": " << doubt.name);
      Guard guard(Model(strategy));
      guard.Reset(1);
      std::vector<double> safe(2);
      for (int t = 0; t < 3; ++t) {
        ASSERT_NE(guard.Filter(t, std::vector{0.0 + t, 0.1 * t, 0.0}, Action(0.0, 0.0), safe).mode,
                  Mode::kHalt);
      }
      std::vector<double> result(doubt.room, 1.0);
      const Verdict verdict = guard.Filter(doubt.t, doubt.state, doubt.action, result);
      EXPECT_EQ(verdict.mode, Mode::kHalt);
      EXPECT_EQ(verdict.cause, doubt.cause) << verdict.reason();
      EXPECT_TRUE(verdict.alarm || doubt.cause != control::HaltCause::kStateInvalid);
      EXPECT_THAT(result, testing::Each(0.0));
      EXPECT_TRUE(doubt.room <= 2 || std::isnan(verdict.change));
      // Valid input afterwards changes nothing.
      const Verdict after = guard.Filter(4, std::vector{4.0, 0.4, 0.0}, Action(0.1, 0.0), safe);
      EXPECT_EQ(after.mode, Mode::kHalt);
      EXPECT_EQ(after.cause, doubt.cause);
      EXPECT_THAT(safe, testing::Each(0.0));
      guard.Reset(1);
      EXPECT_NE(guard.Filter(0, std::vector{0.0, 0.0, 0.0}, Action(0.0, 0.0), safe).mode,
                Mode::kHalt);
    }
  }
}

// The tip moves at half of the demonstrated speed. The time step of the strategy counts the calls,
// and the time step of the alarm follows the state.
TEST(GuardTest, TheTimeStepOfTheAlarmFollowsTheState) {
  Guard guard(Model(Strategy::kEarlyStopping));
  guard.Reset(1);
  CorridorPlant plant;
  std::vector<double> safe(2);
  for (int t = 0; t < 10; ++t) {
    const Verdict verdict = guard.Filter(t, plant.x, Action(0.05, 0.0), safe);
    if (verdict.mode == Mode::kHalt) break;
    EXPECT_EQ(verdict.step, t);
    core::Matrix states(t + 1, 3);
    for (int i = 0; i <= t; ++i) states.row(i) << i, 0.05 * i, 0.0;
    std::vector<int> steps;
    const std::vector<double> levels = guard.model().Levels(states, &steps);
    EXPECT_EQ(verdict.alarm_step, steps.back());
    EXPECT_EQ(verdict.alarm, levels.back() < -guard.model().settings().alarm_level);
    plant.Apply(Action(0.05, 0.0));
  }
}

TEST(GuardTest, ActionsAreWithinTheirLimit) {
  GuardSettings settings = Model()->settings();
  settings.action_limit = {0.05};
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kMonitor}) {
    settings.strategy = strategy;
    Guard guard(Model()->With(settings));
    guard.Reset(1);
    std::vector<double> safe = {10.0, -10.0};
    const Verdict verdict = guard.Filter(0, std::vector{0.0, 0.0, 0.0}, safe, safe);
    EXPECT_EQ(verdict.mode, Mode::kPolicy);
    EXPECT_TRUE(verdict.changed);
    // Conversion to the unit of controls causes rounding.
    EXPECT_THAT(
        safe, testing::Each(testing::AllOf(testing::Ge(-0.05 - 1e-15), testing::Le(0.05 + 1e-15))));
  }
}

TEST(GuardTest, TheLoopNeverAllocates) {
  for (const Strategy strategy : {Strategy::kGuard, Strategy::kDfr, Strategy::kEarlyStopping,
                                  Strategy::kMonitor, Strategy::kController}) {
    Guard guard(Model(strategy));
    const std::vector<double> action = Action(0.09, 0.06);
    std::vector<double> chunk;
    for (int i = 0; i < Guard::kLongestChunk; ++i) {
      chunk.insert(chunk.end(), action.begin(), action.end());
    }
    std::vector<double> safe(2);
    const std::vector<double> broken = {0.0, kNaN, 0.0};
    CorridorPlant plant;
    const test::NoAlloc no_alloc;
    for (int episode = 0; episode < 2; ++episode) {
      guard.Reset(static_cast<std::uint64_t>(episode));
      std::fill(plant.x.begin(), plant.x.end(), 0.0);
      for (int t = 0; t < 50; ++t) {
        static_cast<void>(guard.FilterChunk(t, plant.x, chunk));
        static_cast<void>(guard.Filter(t, plant.x, action, safe));
        if (episode == 1) guard.Applied(action);
        plant.Apply(safe);
      }
      static_cast<void>(guard.Filter(50, broken, action, safe));
    }
  }
}

}  // namespace
}  // namespace dfr::safety
