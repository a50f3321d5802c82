#include "dfr/control/published/switching_controller.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <set>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "tests/control/analytic.h"
#include "tests/support/message_of.h"

namespace dfr::control {
namespace {

using test::PointPlant;
using testing::HasSubstr;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kEndless = std::numeric_limits<double>::infinity();

TEST(SwitchingControllerTest, AppliesTheLearnedControlExactlyWhereTheGateIsOpen) {
  // lambda |u| = 0.25; in one dimension g(x) = 1 - |x|.
  const auto ball = test::UnitBall(1);
  const auto policy = test::ConstantPolicy(1, 0.125);
  SwitchingController stopping(policy, ball, 2.0, {.recovery = Recovery::kEarlyStopping});
  std::vector<double> u(1);

  stopping.Reset(0);
  Step step = stopping.Next(std::vector{0.75 - 1e-9}, u);
  EXPECT_EQ(step.mode, Mode::kPolicy);
  EXPECT_EQ(step.threshold, 0.25);
  EXPECT_NEAR(step.g, 0.25, 1e-8);
  EXPECT_EQ(u[0], 0.125);

  stopping.Reset(0);
  step = stopping.Next(std::vector{0.75}, u);  // g = lambda |u|: line 4 of the algorithm has <=
  EXPECT_EQ(step.mode, Mode::kHalt);
  EXPECT_EQ(step.cause, HaltCause::kEarlyStopping);
  EXPECT_EQ(u[0], 0.0);
}

// x = 0.9, g = 0.1, lambda = 2: |u_delta| = 0.1 / (500 * 2) = 1e-4. With gain 1, g(x_delta) = 0.1
// -+ 1e-4, and |u_R| = g(x_delta) / (50 * 2), towards the centre for either direction of the probe.
TEST(SwitchingControllerTest, ProbeAndStepHaveTheAuthorsSizesAndABadProbeIsReversed) {
  const auto ball = test::UnitBall(1);
  const auto policy = test::ConstantPolicy(1, 1.0);
  std::set<double> probe_signs;
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    PointPlant plant({.start = {0.9}});
    SwitchingController dfr(policy, ball, 2.0);
    dfr.Reset(seed);
    std::vector<double> u(1);

    Step step = dfr.Next(plant.x, u);
    ASSERT_EQ(step.mode, Mode::kProbe);
    EXPECT_EQ(step.threshold, 2.0);
    EXPECT_NEAR(std::abs(u[0]), 1e-4, 1e-18);
    probe_signs.insert(std::copysign(1.0, u[0]));
    ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);

    step = dfr.Next(plant.x, u);
    ASSERT_EQ(step.mode, Mode::kRecovery);
    const double g_delta = 1.0 - plant.x[0];
    EXPECT_EQ(step.g, g_delta);
    EXPECT_NEAR(u[0], -g_delta / 100.0, 1e-18);
    ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);

    // The gate is still closed: the next iteration follows.
    step = dfr.Next(plant.x, u);
    EXPECT_EQ(step.mode, Mode::kProbe);
    EXPECT_EQ(step.iteration, 1);
    EXPECT_NEAR(std::abs(u[0]), (1.0 - plant.x[0]) / 1000.0, 1e-18);
  }
  EXPECT_EQ(probe_signs.size(), 2u) << "both directions must have been tried";
}

TEST(SwitchingControllerTest, AProbeThatEndsOutsideIsFollowedByAStepBack) {
  // g is 0.1 at the start and -0.2 after every probe.
  const test::FunctionSupport cliff(
      1, [](int, std::span<const double> x) { return x[0] == 0.0 ? 0.1 : -0.2; });
  const auto policy = test::ConstantPolicy(1, 1.0);
  SwitchingController dfr(policy, cliff, 1.0);
  dfr.Reset(1);
  std::vector<double> probe(1), step(1);
  ASSERT_EQ(dfr.Next(std::vector{0.0}, probe).mode, Mode::kProbe);
  ASSERT_EQ(dfr.Next(probe, step).mode, Mode::kRecovery);
  EXPECT_NEAR(step[0], -std::copysign(0.2 / 50.0, probe[0]), 1e-18);
  EXPECT_EQ(dfr.Next(std::vector{probe[0] + step[0]}, step).cause, HaltCause::kOutsideSupport);
}

// A probe that changes nothing is reversed: line 7 has g(x_delta) <= g(x_t).
TEST(SwitchingControllerTest, ProbesInVainAreReversedUntilTheIterationLimit) {
  const auto flat = test::ConstantSupport(3, 0.1);
  const auto policy = test::ConstantPolicy(3, 1.0);
  SwitchingController dfr(policy, flat, 1.0);
  dfr.Reset(1);
  const std::vector<double> x(3, 0.0);
  std::vector<double> probe(3), back(3);
  for (int i = 0; i < 500; ++i) {
    ASSERT_EQ(dfr.Next(x, probe).mode, Mode::kProbe) << i;
    ASSERT_EQ(dfr.Next(x, back).mode, Mode::kRecovery) << i;
    for (std::size_t k = 0; k < 3; ++k) ASSERT_NEAR(back[k], -10.0 * probe[k], 1e-18);
  }
  const Step step = dfr.Next(x, back);
  EXPECT_EQ(step.mode, Mode::kHalt);
  EXPECT_EQ(step.cause, HaltCause::kIterationLimit);
  EXPECT_EQ(step.t, 0);
}

TEST(SwitchingControllerTest, RecoveryDoesNotConsumeTimeAndHasItsOwnIterations) {
  // At times 0 and 1 the fifth evaluation of g_t opens the gate, after two iterations.
  std::vector<int> times;
  const test::FunctionSupport support(1, [&](int t, std::span<const double>) {
    times.push_back(t);
    return t == 2 || std::count(times.begin(), times.end(), t) == 5 ? 10.0 : 0.5;
  });
  std::vector<int> policy_times;
  const test::FunctionPolicy policy(1, 1, [&](int t, std::span<const double>, std::span<double> u) {
    policy_times.push_back(t);
    u[0] = 1.0;
  });
  SwitchingController dfr(policy, support, 1.0, {.horizon = 3, .max_iterations = 2});
  dfr.Reset(0);
  std::vector<double> x(1, 0.0), u(1);
  std::string modes;
  for (Step step = dfr.Next(x, u); step.mode != Mode::kHalt; step = dfr.Next(x, u)) {
    modes += std::string(Name(step.mode)) + std::to_string(step.t) + " ";
  }
  EXPECT_EQ(modes,
            "probe0 recovery0 probe0 recovery0 policy0 "
            "probe1 recovery1 probe1 recovery1 policy1 policy2 ");
  EXPECT_EQ(dfr.halt_cause(), HaltCause::kTimeUp);
  EXPECT_THAT(times, testing::ElementsAre(0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 2));
  // The policy is evaluated again in the state after each iteration (line 13).
  EXPECT_THAT(policy_times, testing::ElementsAre(0, 0, 0, 1, 1, 1, 2));
}

TEST(SwitchingControllerTest, BaselineNeverEvaluatesTheSupport) {
  const auto outside = test::ConstantSupport(1, kNaN);
  const auto policy = test::ConstantPolicy(1, 0.5);
  SwitchingController baseline(policy, outside, 1.0, {.recovery = Recovery::kNone, .horizon = 7});
  baseline.Reset(0);
  std::vector<double> x(1, 0.0), u(1);
  for (int t = 0; t < 7; ++t) {
    const Step step = baseline.Next(x, u);
    EXPECT_EQ(step.mode, Mode::kPolicy);
    EXPECT_EQ(step.t, t);
    EXPECT_TRUE(std::isnan(step.g));
    EXPECT_EQ(u[0], 0.5);
  }
  EXPECT_EQ(baseline.Next(x, u).cause, HaltCause::kTimeUp);
  EXPECT_EQ(outside.calls, 0);
}

TEST(SwitchingControllerTest, LambdaIsThatOfTheTimeStepOrTheLastOne) {
  const auto wide = test::ConstantSupport(1, 100.0);
  const auto policy = test::ConstantPolicy(1, 1.0);
  const std::vector<double> lambda = {1.0, 2.0, 4.0, 4.0, 4.0};
  std::vector<double> x(1, 0.0), u(1);
  for (const int first : {0, 1}) {
    SwitchingController dfr(policy, wide, std::vector<double>{1.0, 2.0, 4.0},
                            {.horizon = 5, .first_step = first});
    dfr.Reset(0);
    for (int t = first; t < 5; ++t) {
      const Step step = dfr.Next(x, u);
      EXPECT_EQ(step.t, t);
      EXPECT_EQ(step.threshold, lambda[static_cast<std::size_t>(t)]);
    }
  }
}

// Prop. IV.3 for a support that does not depend on time, the case in which its proof holds. If |x'
// - x| <= K |u| and lambda = L K, g never falls below zero, for any learned policy and any rotation
// of the command by the plant. The ball's g is 1-Lipschitz, so lambda = K.
TEST(SwitchingControllerTest, NeverLeavesSupportWhenLambdaIsLipschitzTimesGain) {
  constexpr double kGain = 2.0;
  const auto ball = test::UnitBall(2);
  const auto outward = test::OutwardPolicy(2, 0.05);
  const DfrOptions authors;
  const DfrOptions coarse{.probe_fraction = 0.3, .step_fraction = 0.9};
  for (const DfrOptions& options : {authors, coarse}) {
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
      SCOPED_TRACE(testing::Message() << "seed = " << seed);
      PointPlant plant({.gain = kGain, .turns = true});
      plant.Reset(seed);
      SwitchingController dfr(outward, ball, kGain, {.horizon = 200, .dfr = options});
      dfr.Reset(seed);
      std::vector<double> u(2);
      while (dfr.Next(plant.x, u).mode != Mode::kHalt) {
        ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
        ASSERT_GE(ball.Decision(0, plant.x), 0.0);
      }
    }
  }
}

TEST(SwitchingControllerTest, HaltsOutsideTheSupportAndOnNonFiniteValues) {
  struct Row {
    const char* what;
    double control;
    double g;
    HaltCause cause;
  };
  const Row rows[] = {
      // Halts even if the learned control is zero.
      {"on the boundary", 0.0, 0.0, HaltCause::kOutsideSupport},
      {"outside", 0.0, -0.5, HaltCause::kOutsideSupport},
      {"no control", kNaN, 1.0, HaltCause::kControlInvalid},
      {"|u| overflows", 1e200, 1.0, HaltCause::kControlInvalid},
      {"no level", 0.1, kNaN, HaltCause::kSupportInvalid},
      {"minus infinity", 0.1, -kEndless, HaltCause::kSupportInvalid},
  };
  for (const Row& row : rows) {
    SCOPED_TRACE(row.what);
    const auto policy = test::ConstantPolicy(2, row.control);
    const auto support = test::ConstantSupport(2, row.g);
    for (const Recovery recovery : {Recovery::kEarlyStopping, Recovery::kDfr}) {
      SwitchingController controller(policy, support, 1.0, {.recovery = recovery});
      controller.Reset(0);
      std::vector<double> u(2, 9.0);
      EXPECT_EQ(controller.Next(std::vector<double>(2), u).cause, row.cause);
      EXPECT_THAT(u, testing::Each(0.0));
    }
  }
  // g is finite before a probe and NaN after it.
  int looks = 0;
  const test::FunctionSupport lost(
      1, [&](int, std::span<const double>) { return ++looks == 1 ? 0.1 : kNaN; });
  const auto policy = test::ConstantPolicy(1, 1.0);
  SwitchingController dfr(policy, lost, 1.0);
  dfr.Reset(0);
  std::vector<double> x(1, 0.0), u(1);
  ASSERT_EQ(dfr.Next(x, u).mode, Mode::kProbe);
  EXPECT_EQ(dfr.Next(x, u).cause, HaltCause::kSupportInvalid);
}

TEST(SwitchingControllerTest, TheSeedDecidesEverythingAndResetStartsAnEpisode) {
  const auto flat = test::ConstantSupport(3, 0.1);
  const auto policy = test::ConstantPolicy(3, 1.0);
  SwitchingController dfr(policy, flat, 1.0);
  const std::vector<double> x(3, 0.0);
  const auto probes = [&](std::uint64_t seed, int controls) {
    dfr.Reset(seed);
    std::vector<double> all, u(3);
    for (int i = 0; i < controls; ++i) {
      (void)dfr.Next(x, u);
      all.insert(all.end(), u.begin(), u.end());
    }
    return all;
  };
  const std::vector<double> first = probes(1, 9);  // ends between a probe and the step after it
  EXPECT_NE(probes(2, 9), first);
  EXPECT_EQ(probes(1, 9), first);
}

// Records its arguments, and returns the given answers.
class ScriptedRecovery final : public RecoveryStrategy {
 public:
  explicit ScriptedRecovery(std::vector<RecoverySituation>& asked, std::vector<Mode> answers)
      : asked_(&asked), answers_(std::move(answers)) {}
  void Reset(std::uint64_t seed) noexcept override { seed_ = seed; }
  Mode Next(const RecoverySituation& situation, std::span<double> u) noexcept override {
    std::fill(u.begin(), u.end(), 0.25 * static_cast<double>(seed_));
    asked_->push_back(situation);
    return answers_[asked_->size() - 1];
  }

 private:
  std::vector<RecoverySituation>* asked_;
  std::vector<Mode> answers_;
  std::uint64_t seed_ = 0;
};

TEST(SwitchingControllerTest, AnInjectedStrategyReplacesThatOfTheOptions) {
  // The gate is closed at g = 0.1 and open at 10. The fourth evaluation of g follows the recovery.
  int looks = 0;
  const test::FunctionSupport support(
      1, [&](int, std::span<const double>) { return ++looks == 4 ? 10.0 : 0.1; });
  const auto policy = test::ConstantPolicy(1, 1.0);
  const std::vector<double> lambda = {2.0};
  for (const Recovery ignored : {Recovery::kNone, Recovery::kEarlyStopping, Recovery::kDfr}) {
    SCOPED_TRACE(Name(ignored));
    looks = 0;
    std::vector<RecoverySituation> asked;
    const std::vector<Mode> answers = {Mode::kProbe, Mode::kRecovery, Mode::kRecovery, Mode::kHalt};
    // The constants of DFR are also ignored: DFR itself would reject these.
    SwitchingController controller(policy, support, lambda,
                                   std::make_unique<ScriptedRecovery>(asked, answers),
                                   {.recovery = ignored, .dfr = {.probe_fraction = -1.0}});
    controller.Reset(3);
    std::vector<double> x(1, 0.0), u(1);
    std::string modes;
    Step step;
    do {
      step = controller.Next(x, u);
      modes += std::string(Name(step.mode)) + " ";
      if (step.mode == Mode::kProbe || step.mode == Mode::kRecovery) {
        EXPECT_EQ(u[0], 0.75) << "the strategy's control, and its seed";
      }
    } while (step.mode != Mode::kHalt);
    EXPECT_EQ(modes, "probe recovery recovery policy halt ");
    EXPECT_EQ(step.cause, HaltCause::kNoDirection);
    ASSERT_EQ(asked.size(), 4u);
    const std::vector<int> times = {0, 0, 0, 1};
    const std::vector<int> iterations = {0, 0, 1, 0};
    for (std::size_t i = 0; i < 4; ++i) {
      EXPECT_EQ(asked[i].t, times[i]) << i;
      EXPECT_EQ(asked[i].iteration, iterations[i]) << i;
      EXPECT_EQ(asked[i].g, 0.1) << i;
      EXPECT_EQ(asked[i].lambda, 2.0) << i;
    }
  }
}

TEST(SwitchingControllerTest, ErrorsNameTheOption) {
  const auto ball = test::UnitBall(2);
  const auto policy = test::ConstantPolicy(2, 1.0);
  const auto message = [&](const core::DecisionFunction& g, std::vector<double> lambda,
                           const SwitchingControllerOptions& options) {
    return test::MessageOf<std::invalid_argument>(
        [&] { SwitchingController(policy, g, lambda, options); });
  };
  EXPECT_THAT(message(test::UnitBall(3), {1}, {}), HasSubstr("the support takes 3"));
  EXPECT_THAT(message(ball, {}, {}), HasSubstr("lambda needs"));
  EXPECT_THAT(message(ball, {1, 0}, {}), HasSubstr("not 0 at step 1"));
  EXPECT_THAT(message(ball, {kNaN}, {}), HasSubstr("at step 0"));
  EXPECT_THAT(message(ball, {1}, {.horizon = 0}), HasSubstr("horizon"));
  EXPECT_THAT(message(ball, {1}, {.first_step = -1}), HasSubstr("first_step"));
  EXPECT_THAT(message(ball, {1}, {.max_iterations = 0}), HasSubstr("max_iterations"));
  EXPECT_THAT(message(ball, {1}, {.dfr = {.probe_fraction = 1.0}}), HasSubstr("probe_fraction"));
  EXPECT_THAT(message(ball, {1}, {.dfr = {.step_fraction = 0.0}}), HasSubstr("step_fraction"));
  EXPECT_THAT(message(ball, {1}, {.dfr = {.step_fraction = 1.0}}), HasSubstr("step_fraction"));
  EXPECT_THAT(test::MessageOf<std::invalid_argument>([&] {
                SwitchingController(policy, ball, std::vector{1.0},
                                    std::unique_ptr<RecoveryStrategy>());
              }),
              HasSubstr("strategy is null"));
}

}  // namespace
}  // namespace dfr::control
