#include "dfr/control/guided/guided_controller.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <span>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/control/constants.h"
#include "dfr/control/published/switching_controller.h"
#include "tests/control/analytic.h"
#include "tests/control/rightwards.h"
#include "tests/support/all_close.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"
#include "tests/support/random_matrix.h"

namespace dfr::control {
namespace {

using testing::HasSubstr;

using test::kSteps;
using test::Rightwards;
using Turned = test::TurnedPoint;

class GuidedControllerTest : public test::RightwardsTest {
 protected:
  struct Course {
    int passed = 0;    // learned controls that were not changed
    int replaced = 0;  // controls of recoveries
  };
  // Expects the plant to reach x = `end` within 60 controls without leaving the supports.
  Course Drive(GuidedController& guided, Turned plant, double end,
               const std::function<void(const Step&)>& check = {}) {
    Course course;
    guided.Reset(1);
    for (int controls = 0; plant.x[0] < end && controls < 60; ++controls) {
      const Step step = guided.Next(plant.x, u);
      EXPECT_NE(step.mode, Mode::kHalt) << Name(step.cause) << " at x = " << plant.x[0];
      if (check) check(step);
      course.passed += step.mode == Mode::kPolicy && !step.filtered ? 1 : 0;
      course.replaced += step.mode == Mode::kRecovery ? 1 : 0;
      plant.Apply(u);
      EXPECT_LT(std::abs(plant.x[1]), 0.42) << "the half width of every B_t";
    }
    EXPECT_GE(plant.x[0], end);
    return course;
  }
};

// A state deep inside does not suffice: a control of 0.6 would cross the next support, and the
// largest demonstrated control to the side would end at its edge.
TEST_F(GuidedControllerTest, DeepInsideControlsPassByTheirPrediction) {
  const std::vector<double> x = {0.05, 0.0};
  const double hi = model.levels.gate(1);
  ASSERT_GE(support.LogDecision(0, x, {}), hi);
  ASSERT_GE(support.LogDecision(1, x, {}), hi);
  const double most = model.response.largest_control() * model.response.control_unit();
  for (const auto& [control, passes] : {std::pair{std::vector{test::kSpeed, 0.0}, true},
                                        {std::vector{0.6, 0.0}, false},
                                        {std::vector{0.0, 0.999 * most}, false}}) {
    SCOPED_TRACE(testing::Message() << control[0] << " " << control[1]);
    const test::FunctionPolicy policy(2, 2,
                                      [&](int, std::span<const double>, std::span<double> out) {
                                        std::copy(control.begin(), control.end(), out.begin());
                                      });
    GuidedController guided(policy, model, {.observer = false});
    const Step step = First(guided, x);
    EXPECT_EQ(step.mode, passes ? Mode::kPolicy : Mode::kRecovery);
    EXPECT_GE(support.LogDecision(1, std::vector{x[0] + u[0], x[1] + u[1]}, {}), -0.01);
    if (passes) {
      EXPECT_EQ(u, control) << "unchanged to the bit";
    } else {
      EXPECT_NEAR(u[0], test::kSpeed, 0.02) << "as demonstrated";
    }
  }
}

// The first controls reveal the lag of a robot whose motion is delayed.
TEST_F(GuidedControllerTest, TheFirstControlsRevealALag) {
  const auto policy = test::ConstantPolicy(2, test::kSpeed);
  GuidedController guided(policy, model);
  guided.Reset(1);
  Turned plant;
  std::vector<double> given = {0.0, 0.0};
  for (int t = 0; t < 8; ++t) {
    const Step step = guided.Next(plant.x, u);
    ASSERT_EQ(step.mode, Mode::kPolicy);
    EXPECT_EQ(step.t, t) << "the phase after the pending controls";
    plant.Apply(given);
    given = u;
  }
  EXPECT_NEAR(plant.x[0], 7.0 * test::kSpeed, 0.02) << "one control late, no slower";
}

// A step reports the levels of the observed state, and their thresholds.
TEST_F(GuidedControllerTest, AStepReportsItsReasons) {
  const auto policy = test::ConstantPolicy(2, 0.1);
  GuidedController guided(policy, model, {.observer = false});
  guided.Reset(1);
  Turned plant{.x = {0.0, 0.9}};
  int t = 0;
  int waited = 0;
  int recoveries = 0;
  for (int i = 0; i < 15; ++i) {
    SCOPED_TRACE(i);
    const Step step = guided.Next(plant.x, u);
    ASSERT_NE(step.mode, Mode::kHalt);
    EXPECT_EQ(step.cause, HaltCause::kNone);
    EXPECT_EQ(step.t, t);
    EXPECT_EQ(step.iteration, waited);
    EXPECT_EQ(step.log_g, support.LogDecision(t, plant.x, {}));
    EXPECT_NEAR(step.g, support.Decision(t, plant.x), 1e-15);
    EXPECT_EQ(step.log_threshold, model.levels.gate(t + 1));
    EXPECT_EQ(step.threshold, support.FromLog(t, step.log_threshold));
    EXPECT_NEAR(step.threshold, 0.5 * (std::exp(step.log_threshold) - 1.0), 1e-15);
    EXPECT_FALSE(step.certified);
    const bool changed = std::abs(u[0] - 0.1) > 1e-15 || u[1] != 0.0;
    EXPECT_EQ(step.filtered, step.mode == Mode::kPolicy && changed);
    if (changed) {
      const double change = std::hypot(u[0] - 0.1, u[1]) / model.response.control_unit();
      EXPECT_NEAR(step.change, change, 1e-12);
    } else {
      EXPECT_TRUE(std::isnan(step.change));
    }
    recoveries += step.mode == Mode::kRecovery ? 1 : 0;
    plant.Apply(u);
    // The plant responds as demonstrated: a state that was predicted inside is inside.
    if (support.LogDecision(t + 1, plant.x, {}) >= 0.0) {
      ++t;
      waited = 0;
    } else {
      ++waited;
    }
  }
  EXPECT_GT(t, 10);
  EXPECT_GT(recoveries, 0);
}

TEST_F(GuidedControllerTest, HaltsAtTheHorizonAndAtTheControlLimit) {
  const auto policy = test::ConstantPolicy(2, test::kSpeed);
  const auto end = [&](const GuidedOptions& options) {
    GuidedController guided(policy, model, options);
    guided.Reset(1);
    Turned plant{.x = {options.first_step * test::kSpeed, 0.0}};
    int controls = 0;
    for (; guided.Next(plant.x, u).mode != Mode::kHalt; ++controls) plant.Apply(u);
    return std::pair(controls, guided.halt_cause());
  };
  EXPECT_EQ(end({.horizon = 7}), std::pair(7, HaltCause::kTimeUp));
  EXPECT_EQ(end({.horizon = 7, .first_step = 4}), std::pair(3, HaltCause::kTimeUp));
  EXPECT_EQ(end({.horizon = 7, .max_controls = 5}), std::pair(5, HaltCause::kIterationLimit));
}

// A policy that leaves the corridor sideways is corrected: the state stays inside, and the task
// progresses.
TEST_F(GuidedControllerTest, FilterKeepsAWrongPolicyInsideAndMoving) {
  for (const double angle : {0.0, 0.9, -2.0}) {
    SCOPED_TRACE(angle);
    const test::Task turned(test::IdentityFeatures(), support, Rightwards(angle));
    const test::FunctionPolicy policy(
        2, 2, [angle](int, std::span<const double>, std::span<double> learned) {
          learned[0] = 0.09 * std::cos(angle) + 0.06 * std::sin(angle);
          learned[1] = -0.09 * std::sin(angle) + 0.06 * std::cos(angle);
        });
    GuidedController guided(policy, turned, {.horizon = 40});
    const Course course = Drive(guided, {.angle = angle}, 1.8);
    EXPECT_GT(course.replaced, 0);
  }
}

// With least intervention, a control that is predicted to end inside passes unchanged, and the
// state still stays in the corridor.
TEST_F(GuidedControllerTest, WithLeastInterventionMoreControlsPass) {
  const test::FunctionPolicy policy(2, 2,
                                    [](int, std::span<const double>, std::span<double> learned) {
                                      learned[0] = 0.0971;
                                      learned[1] = 0.0123;
                                    });
  const auto passed = [&](bool least) {
    GuidedController guided(policy, model, {.horizon = 40, .least_intervention = least});
    const auto check = [&](const Step& step) {
      const bool passes = step.mode == Mode::kPolicy && !step.filtered;
      EXPECT_EQ(passes, u[0] == 0.0971 && u[1] == 0.0123);
    };
    return Drive(guided, {}, 1.8, check).passed;
  };
  EXPECT_GT(passed(true), passed(false));
}

// A controller that takes over during the task begins at the given step.
TEST_F(GuidedControllerTest, StartsAtTheFirstStep) {
  const auto policy = test::ConstantPolicy(2, 0.08);
  GuidedController guided(policy, model, {.horizon = 20, .first_step = 12});
  const Step step = First(guided, {12 * test::kSpeed, 0.0});
  EXPECT_EQ(step.t, 12);
  EXPECT_EQ(step.mode, Mode::kPolicy);
}

// The goal may lie at the edge of the last support, which does not move on. The policy still
// reaches it.
TEST_F(GuidedControllerTest, MovesToTheEdgeOfTheLastSupport) {
  const auto policy = test::ConstantPolicy(2, test::kSpeed);
  GuidedController guided(policy, model, {.horizon = 3 * kSteps});
  guided.Reset(1);
  // right edge of the last support
  double edge = kSteps * test::kSpeed;
  while (support.LogDecision(kSteps, std::vector{edge, 0.0}, {}) >= 0.0) edge += 0.01;
  Turned plant;
  for (int control = 0; control < kSteps + 10; ++control) {
    ASSERT_NE(guided.Next(plant.x, u).mode, Mode::kHalt);
    plant.Apply(u);
  }
  EXPECT_GE(plant.x[0], edge - test::kSpeed / 2.0);
  EXPECT_LE(plant.x[0], edge + test::kSpeed / 2.0) << "and does not leave it";
}

// In this episode the controller is in the last phase, but the state belongs to phase 4 and does
// not move.
TEST_F(GuidedControllerTest, WithLeastInterventionAStuckEpisodeRelocatesItsPhase) {
  const auto policy = test::ConstantPolicy(2, 0.0);
  const std::vector<double> stuck = {4.0 * test::kSpeed, 0.0};
  for (const bool least : {false, true}) {
    GuidedController guided(policy, model,
                            {.horizon = 100, .first_step = kSteps, .least_intervention = least});
    guided.Reset(1);
    int back = 0;
    Step last = guided.Next(stuck, u);
    for (int i = 0; i < 200 && last.mode != Mode::kHalt; ++i) {
      const Step step = guided.Next(stuck, u);
      if (step.mode != Mode::kHalt && step.t < last.t) {
        ++back;
        EXPECT_EQ(step.t, 4);
        EXPECT_EQ(last.iteration + 1, GuidedOptions{}.patience / 2);
      }
      last = step;
    }
    EXPECT_EQ(last.cause, HaltCause::kNoProgress);
    EXPECT_GE(back, least ? 1 : 0);
    EXPECT_LE(back, least ? guided::kMostRelocations : 0);
  }
}

// Observed states stay at the edge, although each control is predicted to end deep inside. After n
// steps EdgeStay counts (1 - .98^n) / .02 steps.
TEST_F(GuidedControllerTest, AStayAtTheEdgeRaisesThePassLevelOverTenSteps) {
  constexpr double kAside = 0.13;
  const test::FunctionPolicy inwards(
      2, 2, [](int, std::span<const double>, std::span<double> learned) {
        std::ranges::copy(std::array{test::kSpeed, -kAside}, learned.begin());
      });
  GuidedController guided(inwards, model,
                          {.least_intervention = true, .online_weight = 0.0, .observer = false});
  guided.Reset(1);
  int between = 0;
  for (int n = 0; n < kSteps; ++n) {
    const std::vector<double> x = {n * test::kSpeed, kAside};
    ASSERT_LT(support.LogDecision(n, x, {}), model.levels.edge(n));
    const Step step = guided.Next(x, u);
    ASSERT_EQ(step.mode, Mode::kPolicy);
    ASSERT_FALSE(step.filtered);
    ASSERT_EQ(step.t, n);
    const double lo = model.levels.pass(n + 1), hi = model.levels.gate(n + 1);
    ASSERT_GT(lo, 0.1);
    const double share = ((1.0 - std::pow(0.98, n)) / 0.02 - 10.0) / 10.0;
    EXPECT_NEAR(step.log_threshold, lo + (hi - lo) * std::clamp(share, 0.0, 1.0), 1e-12) << n;
    between += share > 0.0 && share < 1.0 ? 1 : 0;
  }
  EXPECT_GT(between, 5);
}

// Each state is at the centre of its support. The policy moves to the side: to a level above the
// pass level (c), between it and the pass depth (d), or farther (f).
TEST_F(GuidedControllerTest, AfterTwoCorrectionsInARowThePassDepthWaitsForAPassInside) {
  constexpr double kDepth = 0.3;
  test::Task task{test::IdentityFeatures(), support, Rightwards()};
  task.levels.SetHeldOut(std::vector{HeldOutLevels{.levels = {-kDepth}, .phases = {0}}});
  task.levels.SetPredictionErrors(std::vector{kDepth});
  double level = 0.0;
  const test::FunctionPolicy aside(
      2, 2, [&](int, std::span<const double>, std::span<double> learned) {
        std::ranges::copy(std::array{test::kSpeed, std::sqrt((std::log(2.0) - level) / 4.0)},
                          learned.begin());
      });
  GuidedController guided(
      aside, task,
      {.least_intervention = true, .probe_size = 0.0, .online_weight = 0.0, .observer = false});
  constexpr std::string_view kMoves = "dfdffdfddcdffcd";
  constexpr std::string_view kPassed = "d.d......cd..cd";
  for (int episode = 0; episode < 2; ++episode) {
    guided.Reset(1);
    for (std::size_t n = 0; n < kMoves.size(); ++n) {
      const double pass = task.levels.pass(static_cast<int>(n) + 1);
      level = pass + (kMoves[n] == 'c' ? 0.04 : kMoves[n] == 'd' ? -0.25 * kDepth : -2.0 * kDepth);
      const std::vector<double> x = {static_cast<double>(n) * test::kSpeed, 0.0};
      const Step step = guided.Next(x, u);
      ASSERT_EQ(step.t, static_cast<int>(n));
      EXPECT_NEAR(step.log_learned, level, 0.05) << n;
      EXPECT_EQ(step.mode == Mode::kPolicy && !step.filtered, kPassed[n] != '.') << n;
    }
    // A new episode begins without corrections.
    level = task.levels.pass(1) - 2.0 * kDepth;
    for (const double t : {15.0, 16.0, 17.0}) {
      static_cast<void>(guided.Next(std::vector{t * test::kSpeed, 0.0}, u));
    }
  }
}

// A wrong measurement shows the point far outside, and the next one inside again. Neither the jump
// nor the return is an effect of a control.
TEST_F(GuidedControllerTest, AJumpFarOutsideDoesNotChangeTheResponse) {
  const auto policy = test::ConstantPolicy(2, test::kSpeed);
  GuidedController guided(policy, model, {.observer = false});
  guided.Reset(1);
  const ResponseEstimate untouched(model.response.prior(), {}, model.response.has_drift());
  for (const double x : {0.0, 10.0, 0.1}) {
    const std::vector<double> seen = {x, 0.0};
    const Step step = guided.Next(seen, u);
    ASSERT_NE(step.mode, Mode::kHalt);
    EXPECT_TRUE(guided.jacobian() == untouched.FitAt(step.t, seen).jacobian()) << x;
  }
}

// The policy has a third of the demonstrated speed. The phase waits for it, and the point stays
// inside.
TEST_F(GuidedControllerTest, ThePhaseWaitsForASlowPolicy) {
  const auto slow = test::ConstantPolicy(2, test::kSpeed / 3.0);
  GuidedController guided(slow, model, {.control_limit = {test::kSpeed / 3.0}});
  const Course course = Drive(guided, {}, 1.5, [](const Step& step) {
    EXPECT_GE(step.log_g, -0.4) << "no phase beyond the exit level";
  });
  EXPECT_GT(course.replaced, 15) << "a third of the pace is two waits in three";
}

TEST_F(GuidedControllerTest, ControlsStayWithinThePlantsLimit) {
  const auto policy = test::ConstantPolicy(2, 7.0);
  GuidedController guided(policy, model, {.control_limit = {0.05}});
  core::Random random(1);
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    guided.Reset(seed);
    const std::vector<double> x = {random.Uniform(-1, 1), random.Uniform(-1, 1)};
    for (int i = 0; i < 5; ++i) {
      if (guided.Next(x, u).mode == Mode::kHalt) break;
      for (const double entry : u) ASSERT_LE(std::abs(entry), 0.05 * (1.0 + 1e-12));
    }
  }
}

// The excess over a limit may vanish in the rounding of the control's norm.
TEST_F(GuidedControllerTest, ATinyExcessOverALimitIsRemoved) {
  const test::FunctionPolicy policy(
      2, 2, [](int, std::span<const double>, std::span<double> learned) {
        std::ranges::copy(std::array{test::kSpeed, 1e-10}, learned.begin());
      });
  GuidedController guided(policy, model, {.control_limit = {1.0, 0.0}, .observer = false});
  const Step step = First(guided, {0.0, 0.0});
  EXPECT_EQ(step.mode, Mode::kPolicy);
  EXPECT_TRUE(step.filtered);
  EXPECT_EQ(u[1], 0.0);
}

TEST_F(GuidedControllerTest, HaltsOnANonFiniteControlOrLevel) {
  const auto nothing = test::ConstantPolicy(2, std::nan(""));
  GuidedController guided(nothing, model);
  EXPECT_EQ(First(guided, {0.0, 0.0}).cause, HaltCause::kControlInvalid);
  EXPECT_EQ(First(guided, {1e200, 0.0}).cause, HaltCause::kSupportInvalid);
  // Far away, l of this support underflows to -infinity.
  const auto wrong = test::ConstantPolicy(2, 1.0);
  for (const double far : {1e18, 3.4e38, 1e100}) {
    GuidedController filter(wrong, model, {.least_intervention = true});
    EXPECT_EQ(First(filter, {far, 0.0}).cause, HaltCause::kSupportInvalid) << far;
  }
}

TEST_F(GuidedControllerTest, NextNeverAllocates) {
  const auto policy = test::ConstantPolicy(2, 0.1);
  GuidedController guided(policy, model, {.disturbance_model = {.base = 0.5, .per_control = 1.0}});
  core::Random random(1);
  std::vector<double> x(2);
  const test::NoAlloc guard;
  for (std::uint64_t episode = 0; episode < 30; ++episode) {
    guided.Reset(episode);
    x[0] = 0.3 * random.Normal();
    x[1] = 0.3 * random.Normal();
    for (int i = 0; i < 30; ++i) {
      (void)guided.Next(x, u);
      for (std::size_t k = 0; k < 2; ++k) x[k] += u[k];
    }
  }
}

// The point moves by its control. Eigen would allocate for matrices of 160 rows.
TEST_F(GuidedControllerTest, NextNeverAllocatesWithManyEntries) {
  constexpr int kMany = 160;
  const test::GaussianSupport ball({std::vector<double>(kMany, 0.0)}, 4.0, 0.5, {}, 4);
  core::Random random(1);
  std::vector<core::Trajectory> demonstrations(6);
  for (core::Trajectory& demonstration : demonstrations) {
    demonstration.states = 0.01 * test::RandomMatrix(random, 4, kMany);
    demonstration.controls = demonstration.states.bottomRows(3) - demonstration.states.topRows(3);
  }
  const test::Task task(test::IdentityFeatures(kMany), ball, demonstrations);
  const auto policy = test::ConstantPolicy(kMany, 0.3);
  GuidedController guided(policy, task);
  std::vector<double> x(kMany, 0.02);
  u.resize(kMany);
  guided.Reset(1);
  int changed = 0;
  const test::NoAlloc guard;
  for (int i = 0; i < 4; ++i) {
    changed += guided.Next(x, u).mode != Mode::kPolicy ? 1 : 0;
    for (std::size_t k = 0; k < x.size(); ++k) x[k] += u[k];
  }
  EXPECT_GT(changed, 0);
  EXPECT_EQ(guided.halt_cause(), HaltCause::kNone);
}

TEST_F(GuidedControllerTest, ErrorsNameTheCulprit) {
  const auto message = [&](const GuidedOptions& options, int control_dim = 2) {
    const test::FunctionPolicy policy(2, control_dim, nullptr);
    return test::MessageOf<std::invalid_argument>(
        [&] { const GuidedController guided(policy, model, options); });
  };
  EXPECT_THAT(message({}, 3), HasSubstr("3 control entries"));
  EXPECT_THAT(message({.horizon = 0}), HasSubstr("horizon must"));
  EXPECT_THAT(message({.max_controls = 0}), HasSubstr("max_controls"));
  EXPECT_THAT(message({.control_limit = {-1.0}}), HasSubstr("control_limit"));
  EXPECT_THAT(message({.disturbance_model = {.base = -1.0}}), HasSubstr("disturbance_model"));
  EXPECT_THAT(message({.first_step = -1}), HasSubstr("first_step"));
  EXPECT_THAT(message({.horizon = 20, .first_step = 20}), HasSubstr("first_step"));
  EXPECT_THAT(message({.iterations = -1}), HasSubstr("iterations"));
  EXPECT_THAT(message({.patience = 0}), HasSubstr("patience"));
  for (const double bad : {-0.1, std::nan(""), std::numeric_limits<double>::infinity()}) {
    EXPECT_THAT(message({.max_exit_ratio = bad}), HasSubstr("max_exit_ratio"));
    EXPECT_THAT(message({.probe_size = bad}), HasSubstr("probe_size"));
    EXPECT_THAT(message({.online_weight = bad}), HasSubstr("online_weight"));
  }
}

}  // namespace
}  // namespace dfr::control
