#include "dfr/safety/guard.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "dfr/control/guided/guided_controller.h"
#include "dfr/control/published/switching_controller.h"
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

// The guard equals the named controller with the action as a policy.
TEST(GuardTest, IsTheControllerOfItsStrategy) {
  class Constant final : public core::Policy {
   public:
    explicit Constant(std::vector<double> action) : action_(std::move(action)) {}
    [[nodiscard]] int state_dim() const noexcept override { return 3; }
    [[nodiscard]] int control_dim() const noexcept override { return 2; }
    void Control(int, std::span<const double>, std::span<double> u) const noexcept override {
      std::copy(action_.begin(), action_.end(), u.begin());
    }

   private:
    std::vector<double> action_;
  };
  const std::vector<double> action = Action(0.09, 0.04);
  for (const Strategy strategy :
       {Strategy::kGuard, Strategy::kController, Strategy::kDfr, Strategy::kEarlyStopping}) {
    SCOPED_TRACE(Name(strategy));
    const auto model = Model(strategy);
    const ActionSpace& actions = model->actions();
    const bool steers = strategy == Strategy::kGuard || strategy == Strategy::kController;
    std::vector<double> asked = action;
    if (steers) actions.Measure(action, asked);
    const Constant policy(asked);
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

// For any policy: no state raises an alarm while the robot responds as demonstrated, and the first
// response that differs too much halts.
TEST(GuardTest, ACertifiedGuardRaisesNoAlarmAndHaltsIfItsAssumptionFails) {
  const auto model = GuardModel::Fit(test::CorridorLayout(), test::CorridorDemonstrations(1, 40),
                                     {.features = "tip", .strategy = Strategy::kCertified});
  Guard guard(model);
  core::Random random(5);
  int certified = 0;
  int steps = 0;
  for (int episode = 0; episode < 30; ++episode) {
    guard.Reset(static_cast<std::uint64_t>(episode));
    test::CorridorPlant plant;
    std::vector<double> safe(2);
    for (int t = 0; t < 60; ++t) {
      const std::vector<double> action = {0.3 * random.Normal() + 0.05, 0.3 * random.Normal()};
      const Verdict verdict = guard.Filter(t, plant.x, action, safe);
      ASSERT_NE(verdict.cause, control::HaltCause::kViolated);
      if (verdict.mode == control::Mode::kHalt) break;
      EXPECT_FALSE(verdict.alarm) << "episode " << episode << ", step " << t;
      ++steps;
      certified += verdict.certified ? 1 : 0;
      plant.Apply(safe);
    }
  }
  EXPECT_GT(steps, 300);
  EXPECT_EQ(certified, steps);

  guard.Reset(1);
  test::CorridorPlant plant;
  std::vector<double> safe(2);
  Verdict verdict = guard.Filter(0, plant.x, Action(test::kSpeed, 0.0), safe);
  ASSERT_TRUE(verdict.certified);
  // The robot moves in the opposite direction.
  for (double& entry : safe) entry = -entry;
  plant.Apply(safe);
  verdict = guard.Filter(1, plant.x, Action(test::kSpeed, 0.0), safe);
  EXPECT_STREQ(verdict.reason(), "assumption-violated");
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

struct Doubt {
  const char* name;
  HaltCause cause;
  std::function<Verdict(Guard&, std::span<double> safe)> call;
};

std::vector<Doubt> Doubts() {
  static const std::vector<double> kState = {3.0, 0.3, 0.0};
  static const std::vector<double> kAction = Action(0.1, 0.0);
  const auto with_state = [](std::vector<double> state) {
    return [state = std::move(state)](Guard& guard, std::span<double> safe) {
      return guard.Filter(3, state, kAction, safe);
    };
  };
  const auto with_action = [](std::vector<double> action) {
    return [action = std::move(action)](Guard& guard, std::span<double> safe) {
      return guard.Filter(3, kState, action, safe);
    };
  };
  const auto at = [](int t) {
    return [t](Guard& guard, std::span<double> safe) {
      return guard.Filter(t, kState, kAction, safe);
    };
  };
  return {
      {"NaN in a feature", HaltCause::kStateInvalid, with_state({3.0, kNaN, 0.0})},
      {"NaN in an entry that no feature uses", HaltCause::kStateInvalid,
       with_state({kNaN, 0.3, 0.0})},
      {"infinite state", HaltCause::kStateInvalid, with_state({3.0, 0.3, -kInfinity})},
      {"short state", HaltCause::kStateInvalid, with_state({0.3, 0.0})},
      {"long state", HaltCause::kStateInvalid, with_state({3.0, 0.3, 0.0, 0.0})},
      {"no state", HaltCause::kStateInvalid, with_state({})},
      {"NaN action", HaltCause::kControlInvalid, with_action({0.1, kNaN})},
      {"infinite action", HaltCause::kControlInvalid, with_action({kInfinity, 0.0})},
      {"short action", HaltCause::kControlInvalid, with_action({0.1})},
      {"no action", HaltCause::kControlInvalid, with_action({})},
      {"a step twice", HaltCause::kStepSkipped, at(2)},
      {"a step left out", HaltCause::kStepSkipped, at(4)},
      {"a negative step", HaltCause::kStepSkipped, at(-1)},
      {"a step far out of range", HaltCause::kStepSkipped, at(std::numeric_limits<int>::max())},
      {"no room for the result", HaltCause::kControlInvalid,
       [](Guard& guard, std::span<double> safe) {
         return guard.Filter(3, kState, kAction, safe.first(1));
       }},
      {"too much room for the result", HaltCause::kControlInvalid,
       [](Guard& guard, std::span<double> safe) {
         std::vector<double> more(1000, 1.0);
         const Verdict verdict = guard.Filter(3, kState, kAction, more);
         EXPECT_THAT(more, testing::Each(0.0));
         EXPECT_TRUE(std::isnan(verdict.change));
         std::fill(safe.begin(), safe.end(), 0.0);
         return verdict;
       }},
  };
}

// The actions of a policy that stays inside pass unchanged to the bit, although many states of the
// corridor are not deep inside. With strategy `controller`, demonstrated actions replace most of
// them.
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

// Demonstrations of the corridor with each action entry rescaled, and a gripper that closes half
// way.
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
      std::fill(safe.begin(), safe.end(), 1.0);
      const Verdict verdict = doubt.call(guard, safe);
      EXPECT_EQ(verdict.mode, Mode::kHalt);
      EXPECT_EQ(verdict.cause, doubt.cause) << verdict.reason();
      EXPECT_EQ(safe[0], 0.0);
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

TEST(GuardTest, HaltsBeforeResetAndWhenStopped) {
  Guard guard(Model());
  std::vector<double> safe = {1.0, 1.0};
  const Verdict early = guard.Filter(0, std::vector{0.0, 0.0, 0.0}, Action(0.1, 0.0), safe);
  EXPECT_EQ(early.mode, Mode::kHalt);
  EXPECT_STREQ(early.reason(), "not-reset");
  EXPECT_THAT(safe, testing::Each(0.0));
  guard.Reset();
  guard.Stop();
  const Verdict stopped = guard.Filter(0, std::vector{0.0, 0.0, 0.0}, Action(0.1, 0.0), safe);
  EXPECT_STREQ(stopped.reason(), "stop-requested");
}

// The tip moves at half of the demonstrated speed. The time step of the strategy counts the calls,
// and that of the alarm follows the state.
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
    std::vector<double> safe(2);
    const std::vector<double> broken = {0.0, kNaN, 0.0};
    CorridorPlant plant;
    const test::NoAlloc no_alloc;
    for (int episode = 0; episode < 2; ++episode) {
      guard.Reset(static_cast<std::uint64_t>(episode));
      std::fill(plant.x.begin(), plant.x.end(), 0.0);
      for (int t = 0; t < 50; ++t) {
        static_cast<void>(guard.Filter(t, plant.x, action, safe));
        plant.Apply(safe);
      }
      static_cast<void>(guard.Filter(50, broken, action, safe));
    }
  }
}

}  // namespace
}  // namespace dfr::safety
