#include "dfr/control/guided/guided_controller.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/control/guided/constants.h"
#include "dfr/control/published/switching_controller.h"
#include "tests/control/analytic.h"
#include "tests/control/rightwards.h"
#include "tests/control/task.h"
#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

using testing::HasSubstr;

using test::kSteps;
using test::MovingDisk;
using test::Rightwards;
using Turned = test::TurnedPoint;

core::FeatureTransform Identity() { return test::IdentityFeatures(); }

// A state off the middle drifts away; controls still bring it back.
std::vector<core::Trajectory> Toppling() {
  auto demonstrations = Rightwards();
  for (core::Trajectory& demonstration : demonstrations) {
    for (Eigen::Index t = 0; t < demonstration.controls.rows(); ++t) {
      demonstration.controls(t, 1) -= 0.9 * demonstration.states(t, 1);
    }
  }
  return demonstrations;
}
// In features as wide as whitened ones, and MovingDisk() in these.
core::FeatureTransform Thirtyfold() {
  return {core::FeatureSelection::All(2), Eigen::Vector2d::Zero(),
          30.0 * core::Matrix::Identity(2, 2)};
}
test::GaussianSupport ThirtyfoldDisk() {
  return {{{0.0, 0.0}}, 4.0 / 900.0, 0.5, {30.0 * test::kSpeed, 0.0}, kSteps + 1};
}

TEST(GuidedControllerTest, PassesTheLearnedControlDeepInside) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.08);
  GuidedController guided(policy, model, {.observer = false});
  guided.Reset(1);
  std::vector<double> u(2);
  const Step step = guided.Next(std::vector{0.05, 0.0}, u);
  EXPECT_EQ(step.mode, Mode::kPolicy);
  EXPECT_FALSE(step.filtered);
  EXPECT_NEAR(u[0], 0.08, 1e-16);  // to the control unit and back
  EXPECT_EQ(u[1], 0.0);
  EXPECT_GE(step.log_g, step.log_threshold);
  EXPECT_TRUE(guided.jacobian().isZero(0.0)) << "nobody has asked for J";
}

// Controls that pass deep inside without an estimate of J do not update it.
TEST(GuidedControllerTest, ControlsBeforeTheFirstEstimateDoNotChangeIt) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.8 * test::kSpeed);
  std::vector<double> u(2);
  const std::vector<double> aside = {3 * test::kSpeed, 0.3};
  GuidedController after(policy, model, {.observer = false});
  after.Reset(1);
  for (int t = 0; t < 3; ++t) {
    (void)after.Next(std::vector{(t + 0.5) * test::kSpeed, 0.0}, u);
    ASSERT_TRUE(after.jacobian().isZero(0.0));
  }
  (void)after.Next(aside, u);
  GuidedController at_once(policy, model, {.first_step = 3, .observer = false});
  at_once.Reset(1);
  (void)at_once.Next(aside, u);
  ASSERT_GT(at_once.jacobian().norm(), 0.0);
  EXPECT_TRUE(test::AllClose(after.jacobian(), at_once.jacobian(), 1e-12));
}

// Twice as large as any demonstrated control, it would cross the next support and leave it.
TEST(GuidedControllerTest, LooksAtAControlLargerThanDemonstrated) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const std::vector<double> x = {0.05, 0.0};
  std::vector<double> u(2);
  const double most = model.response.largest_control() * model.response.control_unit();
  for (const double size : {0.999 * most, 1.001 * most, 0.6}) {
    SCOPED_TRACE(size);
    const auto policy = test::ConstantPolicy(2, size);
    GuidedController guided(policy, model, {.observer = false});
    guided.Reset(1);
    const Step step = guided.Next(x, u);
    EXPECT_EQ(guided.jacobian().isZero(0.0), size < most) << "only below it passes unseen";
    EXPECT_GE(support.LogDecision(1, std::vector{x[0] + u[0], x[1] + u[1]}, {}), -0.01);
    if (size == 0.6) {
      EXPECT_EQ(step.mode, Mode::kRecovery);
      EXPECT_NEAR(u[0], test::kSpeed, 0.02) << "as demonstrated";
    } else {
      EXPECT_EQ(step.mode, size > most ? Mode::kRecovery : Mode::kPolicy);
      EXPECT_FALSE(step.filtered) << "deep inside nothing is changed";
    }
  }
}

// A lag shows in the first controls, wherever they are.
TEST(GuidedControllerTest, TheFirstControlsShowALag) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, test::kSpeed);
  GuidedController guided(policy, model);
  guided.Reset(1);
  std::vector<double> u(2);
  Turned plant;
  std::vector<double> given = {0.0, 0.0};
  for (int t = 0; t < 8; ++t) {
    const Step step = guided.Next(plant.x, u);
    ASSERT_EQ(step.mode, Mode::kPolicy);
    EXPECT_EQ(step.t, t) << "the phase that controls under way lead to";
    plant.Apply(given);
    given = u;
  }
  EXPECT_NEAR(plant.x[0], 7.0 * test::kSpeed, 0.02) << "one control late, no slower";
}

// Deep inside the present support alone, or the next one alone, is not enough.
TEST(GuidedControllerTest, DeepInsideIsInsideBothSupports) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.08);
  const double hi = model.levels.gate(1);
  std::vector<double> u(2);
  int only_one = 0;
  for (int i = 0; i < 70; ++i) {
    const double x = -0.3 + 0.01 * i;
    SCOPED_TRACE(x);
    const std::vector<double> z = {x, 0.0};
    const bool now = support.LogDecision(0, z, {}) >= hi;
    const bool then = support.LogDecision(1, z, {}) >= hi;
    GuidedController fresh(policy, model, {.observer = false});
    fresh.Reset(1);
    ASSERT_NE(fresh.Next(z, u).mode, Mode::kHalt);
    EXPECT_EQ(fresh.jacobian().isZero(0.0), now && then);
    only_one += now != then ? 1 : 0;
  }
  EXPECT_GT(only_one, 5);
}

// A step reports the support's values of the state, here of the observed one.
TEST(GuidedControllerTest, AStepTellsItsGrounds) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.1);
  GuidedController guided(policy, model, {.observer = false});
  guided.Reset(1);
  Turned plant{.x = {0.0, 0.9}};
  std::vector<double> u(2);
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
    recoveries += step.mode == Mode::kRecovery ? 1 : 0;
    plant.Apply(u);
    // The plant responds as in the demonstrations: predictions inside are correct.
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

TEST(GuidedControllerTest, EndsWithItsTimeAndItsControls) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, test::kSpeed);
  const auto end = [&](const GuidedOptions& options) {
    GuidedController guided(policy, model, options);
    guided.Reset(1);
    Turned plant{.x = {options.first_step * test::kSpeed, 0.0}};
    std::vector<double> u(2);
    int controls = 0;
    for (; guided.Next(plant.x, u).mode != Mode::kHalt; ++controls) plant.Apply(u);
    return std::pair(controls, guided.halt_cause());
  };
  EXPECT_EQ(end({.horizon = 7}), std::pair(7, HaltCause::kTimeUp));
  EXPECT_EQ(end({.horizon = 7, .first_step = 4}), std::pair(3, HaltCause::kTimeUp));
  EXPECT_EQ(end({.horizon = 7, .max_controls = 5}), std::pair(5, HaltCause::kIterationLimit));
}

// The control of a policy that leaves the corridor sideways is changed: the next state keeps its
// level, and the task progresses.
TEST(GuidedControllerTest, FilterKeepsAWrongPolicyInsideAndMoving) {
  for (const double angle : {0.0, 0.9, -2.0}) {
    SCOPED_TRACE(angle);
    const auto support = MovingDisk();
    const test::Task model(Identity(), support, Rightwards(angle));
    const test::FunctionPolicy policy(2, 2,
                                      [angle](int, std::span<const double>, std::span<double> u) {
                                        const double dx = 0.09, dy = 0.06;
                                        u[0] = std::cos(angle) * dx + std::sin(angle) * dy;
                                        u[1] = -std::sin(angle) * dx + std::cos(angle) * dy;
                                      });
    Turned plant{.angle = angle};
    GuidedController guided(policy, model, {.horizon = 40});
    guided.Reset(1);
    std::vector<double> u(2);
    int replaced = 0;
    int controls = 0;
    while (plant.x[0] < 1.8 && controls < 60) {
      const Step step = guided.Next(plant.x, u);
      ASSERT_NE(step.mode, Mode::kHalt) << Name(step.cause) << " at x = " << plant.x[0];
      plant.Apply(u);
      replaced += step.mode == Mode::kRecovery ? 1 : 0;
      ++controls;
      ASSERT_LT(std::abs(plant.x[1]), 0.42) << "the half width of every B_t";
    }
    EXPECT_GE(plant.x[0], 1.8);
    EXPECT_GT(replaced, 0);
  }
}

// In strategy guard a control that is predicted to end inside passes unchanged, and the state still
// stays in the corridor.
TEST(GuidedControllerTest, WithLeastInterventionWhatEndsInsidePasses) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  int passed[] = {0, 0};
  for (const bool least : {false, true}) {
    const test::FunctionPolicy policy(2, 2, [](int, std::span<const double>, std::span<double> u) {
      u[0] = 0.0971;
      u[1] = 0.0123;
    });
    Turned plant{};
    GuidedController guided(policy, model, {.horizon = 40, .least_intervention = least});
    guided.Reset(1);
    std::vector<double> u(2);
    for (int controls = 0; plant.x[0] < 1.8 && controls < 60; ++controls) {
      const Step step = guided.Next(plant.x, u);
      ASSERT_NE(step.mode, Mode::kHalt) << Name(step.cause) << " at x = " << plant.x[0];
      const bool passes = step.mode == Mode::kPolicy && !step.filtered;
      ASSERT_EQ(passes, u[0] == 0.0971 && u[1] == 0.0123);
      passed[least ? 1 : 0] += passes ? 1 : 0;
      plant.Apply(u);
      ASSERT_LT(std::abs(plant.x[1]), 0.42) << "the half width of every B_t";
    }
    EXPECT_GE(plant.x[0], 1.8);
  }
  EXPECT_GT(passed[1], passed[0]);
}

TEST(GuidedControllerTest, ComesBackFromOutside) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards(0.7));
  const auto still = test::ConstantPolicy(2, 0.0);
  Turned plant{.angle = 0.7, .x = {0.0, 1.5}};
  ASSERT_LT(support.Decision(0, plant.x), -0.4) << "so far out that g is flat";
  GuidedController guided(still, model);
  guided.Reset(1);
  std::vector<double> u(2);
  int controls = 0;
  while (support.Decision(0, plant.x) < 0.0 && controls < 10) {
    ASSERT_NE(guided.Next(plant.x, u).mode, Mode::kHalt) << controls;
    plant.Apply(u);
    ++controls;
  }
  EXPECT_LT(controls, 10);
}

// A controller that takes over in mid-task looks for its phase there.
TEST(GuidedControllerTest, BeginsAtTheFirstStepItIsGiven) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.08);
  std::vector<double> u(2);
  GuidedController guided(policy, model, {.horizon = 20, .first_step = 12});
  guided.Reset(1);
  const Step step = guided.Next(std::vector{12 * test::kSpeed, 0.0}, u);
  EXPECT_EQ(step.t, 12);
  EXPECT_EQ(step.mode, Mode::kPolicy);
  SwitchingController dfr(policy, support, 0.01, {.horizon = 20, .first_step = 12});
  dfr.Reset(1);
  EXPECT_EQ(dfr.Next(std::vector{12 * test::kSpeed, 0.0}, u).t, 12);
  EXPECT_THROW(GuidedController(policy, model, {.horizon = 20, .first_step = 20}),
               std::invalid_argument);
  EXPECT_THROW(SwitchingController(policy, support, 0.01, {.horizon = 20, .first_step = -1}),
               std::invalid_argument);
}

// A third entry of the state, an object off to the side, that no control moves: the best that can
// be reached is l = -0.3.
class Aside : public testing::Test {
 protected:
  static std::vector<core::Trajectory> Demonstrations() {
    std::vector<core::Trajectory> demonstrations = Rightwards();
    for (core::Trajectory& d : demonstrations) {
      d.states.conservativeResize(Eigen::NoChange, 3);
      d.states.col(2).setZero();
    }
    return demonstrations;
  }
  [[nodiscard]] test::Task Model(double slack) const {
    return {test::IdentityFeatures(3), support_, Demonstrations(), {.slack = slack}};
  }
  static test::FunctionPolicy Along(double speed) {
    return {3, 2, [speed](int, std::span<const double>, std::span<double> u) {
              u[0] = speed;
              u[1] = 0.0;
            }};
  }

  test::GaussianSupport support_{{{0.0, 0.0, 0.0}}, 4.0, 0.5, {test::kSpeed, 0.0, 0.0}, kSteps + 1};
  double offset_ = std::sqrt((0.3 - std::log(0.5)) / 4.0);  // -4 offset^2 - log 0.5 = -0.3
};
using GuidedControllerSlackTest = Aside;

// If no control can correct the state, the best one passes within an exit level of twice the slack.
// Beyond, recoveries apply the demonstrated controls, and the phase skips supports that they miss.
TEST_F(GuidedControllerSlackTest, TheBestGoesOnWithinReachAndTheDemonstrationsBeyond) {
  const auto policy = Along(test::kSpeed);
  for (const double slack : {0.14, 0.16}) {
    SCOPED_TRACE(slack);
    const test::Task model = Model(slack);
    GuidedController guided(policy, model);
    guided.Reset(1);
    std::vector<double> u(2), x = {0.0, 0.0, offset_};
    Step step;
    int controls = 0;
    for (; controls < kSteps; ++controls) {
      step = guided.Next(x, u);
      if (step.mode == Mode::kHalt) break;
      if (slack < 0.15) {
        EXPECT_EQ(step.mode, Mode::kRecovery) << controls;
      } else {
        EXPECT_EQ(step.t, controls);
      }
      x[0] += u[0];
      x[1] += u[1];
    }
    EXPECT_EQ(controls, kSteps);
    EXPECT_NEAR(x[0], kSteps * test::kSpeed, 0.02);
    // Demonstrations go to y = 0 by y' = 0.7 y + noise; the regression over some 130 of them is off
    // by noise / sqrt(130), and y by 1 / 0.3 times that: three standard errors.
    EXPECT_NEAR(x[1], 0.0, 3.0 * 0.05 / std::sqrt(130.0) / 0.3);
  }
}

// The filter reaches at most -0.3, at B_1's centre except for the object. It passes if this is
// within the exit level, a multiple of the slack, here 0.2.
TEST_F(GuidedControllerSlackTest, TheFilteredControlPassesWithinReach) {
  const auto policy = Along(test::kSpeed);
  const test::Task model = Model(0.2);
  for (const double ratio : {0.0, 1.0, 2.0}) {
    SCOPED_TRACE(ratio);
    GuidedController guided(policy, model, {.max_exit_ratio = ratio});
    guided.Reset(1);
    std::vector<double> u(2);
    const Step step = guided.Next(std::vector{0.0, 0.0, offset_}, u);
    EXPECT_EQ(step.mode, ratio < 1.5 ? Mode::kRecovery : Mode::kPolicy);
    EXPECT_NEAR(u[0], test::kSpeed, 0.003) << "as demonstrated, or as it is";
  }
}

// The object is too far aside. Ascent would end at B_1's centre, but the demonstrated control, to
// the right, is applied. Its y component is shrunk by the regression's ridge, because these
// features are far smaller than whitened ones.
TEST_F(GuidedControllerSlackTest, ARecoveryThatStaysOutsideDoesWhatDemonstrationsDid) {
  const auto policy = Along(-test::kSpeed);
  const test::Task model = Model(0.1);
  const std::vector<double> x = {0.0, 0.1, offset_};
  GuidedController guided(policy, model, {.max_exit_ratio = 0.0});
  guided.Reset(1);
  std::vector<double> u(2);
  const Step step = guided.Next(x, u);
  EXPECT_EQ(step.mode, Mode::kRecovery);
  EXPECT_NEAR(u[0], test::kSpeed, 0.003);
  EXPECT_LT(u[1], 0.0);
  EXPECT_GT(u[1], -0.3 * x[1]);
}

TEST(ResponseTest, SaysWhetherFeaturesMoveByThemselves) {
  const auto support = ThirtyfoldDisk();
  EXPECT_FALSE(test::Task(Thirtyfold(), support, Rightwards()).response.has_drift());
  EXPECT_TRUE(test::Task(Thirtyfold(), support, Toppling()).response.has_drift());
}

TEST(LevelsTest, SlackIsWhatUnseenDemonstrationsNeed) {
  std::vector<double> levels;
  for (int i = 0; i <= 100; ++i) levels.push_back(0.5 - 0.02 * i);  // 0.5 ... -1.5
  EXPECT_NEAR(EstimateSlack(levels), 1.1, 1e-12);                   // the 0.2-quantile
  EXPECT_EQ(EstimateSlack({0.1, 0.2, 0.3}), LevelOptions().slack) << "never less";
  EXPECT_THROW((void)EstimateSlack({}), std::invalid_argument);
}

// If no control has an effect, the controller halts in the end. The goal may lie at the edge of the
// last support, which does not move on.
TEST(GuidedControllerTest, DoesNotStandStillInTheLastSupport) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, test::kSpeed);
  GuidedOptions options;
  options.horizon = 3 * kSteps;
  GuidedController guided(policy, model, options);
  guided.Reset(1);
  // Edge of the last support.
  double edge = kSteps * test::kSpeed;
  while (support.LogDecision(kSteps, std::vector{edge, 0.0}, {}) >= 0.0) edge += 0.01;
  Turned plant;
  std::vector<double> u(2);
  for (int control = 0; control < kSteps + 10; ++control) {
    ASSERT_NE(guided.Next(plant.x, u).mode, Mode::kHalt);
    plant.Apply(u);
  }
  EXPECT_GE(plant.x[0], edge - test::kSpeed / 2.0);
  EXPECT_LE(plant.x[0], edge + test::kSpeed / 2.0) << "and does not leave it";
}

TEST(GuidedControllerTest, HoldsWhereNothingHelps) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.1);
  const std::vector<double> stuck = {0.0, 0.6};
  GuidedController guided(policy, model);
  guided.Reset(1);
  std::vector<double> u(2);
  int controls = 0;
  Step step;
  do {
    step = guided.Next(stuck, u);
    ++controls;
  } while (step.mode != Mode::kHalt && controls < 1000);
  EXPECT_EQ(step.cause, HaltCause::kNoProgress);
  EXPECT_LE(controls, 41);
}

// An episode in the last phase whose state belongs to the fourth one, and does not move.
TEST(GuidedControllerTest, WithLeastInterventionAStuckEpisodeGoesOnFromItsState) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.0);
  const std::vector<double> stuck = {4.0 * test::kSpeed, 0.0};
  for (const bool least : {false, true}) {
    GuidedController guided(policy, model,
                            {.horizon = 100, .first_step = kSteps, .least_intervention = least});
    guided.Reset(1);
    std::vector<double> u(2);
    std::vector<int> phases;
    Step step = guided.Next(stuck, u);
    for (int i = 0; i < 200 && step.mode != Mode::kHalt; ++i) {
      phases.push_back(step.t);
      step = guided.Next(stuck, u);
    }
    EXPECT_EQ(step.cause, HaltCause::kNoProgress);
    int back = 0;
    for (std::size_t i = 1; i < phases.size(); ++i) {
      if (phases[i] >= phases[i - 1]) continue;
      ++back;
      EXPECT_EQ(phases[i], 4);
    }
    EXPECT_GE(back, least ? 1 : 0);
    EXPECT_LE(back, least ? guided::kMostRelocations : 0);
  }
}

// A support that does not move, and a point outside that no control moves: every decision is in the
// same state.
std::string Modes(double y, const GuidedOptions& options) {
  const test::GaussianSupport support({{0.0, 0.0}}, 4.0, 0.5);
  const test::Task model(Identity(), support, Rightwards());
  const auto still = test::ConstantPolicy(2, 0.0);
  GuidedController guided(still, model, options);
  guided.Reset(1);
  std::vector<double> u(2);
  std::string modes;
  for (int i = 0; i < 15; ++i) {
    const Step step = guided.Next(std::vector{0.0, y}, u);
    if (step.mode == Mode::kHalt) return modes + " " + Name(step.cause);
    modes += step.mode == Mode::kPolicy ? "P" : "R";
  }
  return modes;
}

TEST(GuidedControllerTest, HaltsAfterItsPatienceWhereItStaysOutside) {
  EXPECT_EQ(Modes(2.5, {}), "RRRRRRRRRRRR no-progress");
  EXPECT_EQ(Modes(2.5, {.patience = 5}), "RRRRR no-progress");
}

// Supports at x = t test::kSpeed, and a point above the path, which demonstrated controls move past
// them. The phase advances with the prediction, and skips the missed support.
TEST(GuidedControllerTest, ThePhasePassesOverSupportsThatARecoveryMisses) {
  const auto support = MovingDisk();
  // Demonstrations with constant y: they contain no way down.
  auto demonstrations = Rightwards();
  for (auto& d : demonstrations) {
    d.states.col(1).setConstant(d.states(0, 1));
    d.controls.col(1).setZero();
  }
  const test::Task model(Identity(), support, demonstrations);
  const auto still = test::ConstantPolicy(2, 0.0);
  GuidedController guided(still, model, {.probe_size = 0.0});
  guided.Reset(1);
  std::vector<double> x = {0.0, 1.0};
  std::vector<double> u(2);
  Step step = guided.Next(x, u);
  for (int i = 1; i < kSteps && step.mode != Mode::kHalt; ++i) {
    x[0] += u[0];  // No control moves it down.
    step = guided.Next(x, u);
  }
  EXPECT_EQ(step.mode, Mode::kRecovery);
  EXPECT_GE(step.t, kSteps / 2);
}

// Demonstrations that never move sideways have no data on the effect of the second control.
std::vector<core::Trajectory> Sideless() {
  auto demonstrations = Rightwards();
  for (auto& d : demonstrations) d.controls.col(1).setZero();
  return demonstrations;
}

TEST(GuidedControllerTest, ProbesAControlThatNobodyHasEverUsed) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Sideless());
  const auto along = test::ConstantPolicy(2, test::kSpeed);
  const std::vector<double> x = {0.0, 0.6};  // beyond the exit level
  std::vector<double> u(2);
  GuidedController guided(along, model);
  guided.Reset(1);
  Step step = guided.Next(x, u);
  EXPECT_EQ(step.mode, Mode::kProbe);
  EXPECT_FALSE(step.filtered);
  EXPECT_GT(std::abs(u[1]), 10.0 * std::abs(u[0]));
  EXPECT_NEAR(test::Norm(u), 0.35 * model.response.control_unit(), 1e-12);
  // The direction was probed: no second probe.
  step = guided.Next(std::vector{x[0] + u[0], x[1] + u[1]}, u);
  EXPECT_NE(step.mode, Mode::kProbe);

  GuidedController never(along, model, {.probe_size = 0.0});
  never.Reset(1);
  EXPECT_NE(never.Next(x, u).mode, Mode::kProbe);
  // Nor if the response is known or the prediction is inside. Under a disturbance that is not
  // sufficient.
  const test::Task known(Identity(), support, Rightwards());
  GuidedController knows(along, known);
  knows.Reset(1);
  EXPECT_EQ(knows.Next(x, u).mode, Mode::kRecovery);
  const std::vector<double> inside = {0.0, 0.35};
  guided.Reset(1);
  EXPECT_NE(guided.Next(inside, u).mode, Mode::kProbe);
  GuidedController disturbed(along, model, {.disturbance_model = {.base = 1.0}});
  disturbed.Reset(1);
  EXPECT_EQ(disturbed.Next(inside, u).mode, Mode::kProbe);
  disturbed.Reset(1);
  EXPECT_EQ(disturbed.Next(std::vector{0.0, 0.0}, u).mode, Mode::kPolicy) << "deep inside";
}

// The world drifts sideways by more than a probe moves it, in a direction without demonstrated
// controls. A controller that takes the disturbance for the probe's effect steers the wrong way;
// one that estimates the disturbance does not.
TEST(GuidedControllerTest, HoldsItsPlaceUnderADisturbance) {
  constexpr double kDisturbance = 0.06;  // a probe is 0.035
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Sideless(), {.gate_quantile = 0.5});
  const auto rightwards = test::FunctionPolicy(
      2, 2, [](int, std::span<const double>, std::span<double> u) { u[0] = 0.1, u[1] = 0.0; });
  const auto farthest = [&](const DisturbanceModel& disturbance_model, double sign) {
    // The exit level would let the disturbance carry the state away, and the nominal control leads
    // back without a J.
    GuidedOptions options = Without({}, "exit-level+demonstrated");
    options.horizon = 60;
    options.disturbance_model = disturbance_model;
    GuidedController guided(rightwards, model, options);
    guided.Reset(1);
    std::vector<double> x = {0.0, 0.0};
    std::vector<double> u(2);
    double y = 0.0;
    for (int controls = 0; x[0] < 1.8; ++controls) {
      if (controls == 60 || guided.Next(x, u).mode == Mode::kHalt) return 1.0;
      x[0] += u[0];
      x[1] += u[1] + sign * kDisturbance;
      y = std::max(y, std::abs(x[1]));
    }
    return y;
  };
  double aware = 0.0;
  for (const double sign : {1.0, -1.0}) {
    aware = std::max(aware, farthest({.base = 1.0}, sign));
    // Attributing half of the time to the control's norm is accurate enough.
    aware = std::max(aware, farthest({.base = 0.5, .per_control = 0.5}, sign));
  }
  EXPECT_LT(aware, 0.2) << "two steps of the disturbance, a probe, and what is left of J's error";
  EXPECT_GT(std::max(farthest({}, 1.0), farthest({}, -1.0)), 1.5 * aware);
}

// A policy at a third of the demonstrated speed: the phase waits for it, and the point stays
// inside.
TEST(GuidedControllerTest, ThePhaseWaitsForAPolicyThatIsLate) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto slow = test::ConstantPolicy(2, test::kSpeed / 3.0);
  Turned plant;
  GuidedController guided(slow, model, {.control_limit = {test::kSpeed / 3.0}});
  guided.Reset(1);
  std::vector<double> u(2);
  int recoveries = 0;
  for (int controls = 0; plant.x[0] < 1.5; ++controls) {
    ASSERT_LT(controls, 60);
    const Step step = guided.Next(plant.x, u);
    ASSERT_NE(step.mode, Mode::kHalt) << Name(step.cause) << " at x = " << plant.x[0];
    EXPECT_GE(step.log_g, -0.4) << "no phase beyond the exit level";
    recoveries += step.mode == Mode::kRecovery ? 1 : 0;
    plant.Apply(u);
  }
  EXPECT_GT(recoveries, 15) << "a third of the pace is two waits in three";
}

// Runs a controller in a world and returns its modes, times and controls.
std::vector<double> Trace(const core::Policy& policy, const test::Task& model,
                          const GuidedOptions& options, std::vector<double> x, int controls,
                          double angle = 0.0, double disturbance = 0.0, int late = 0,
                          double noise = 0.0) {
  GuidedController guided(policy, model, options);
  guided.Reset(1);
  Turned plant{.angle = angle, .x = std::move(x)};
  std::vector<double> trace;
  std::vector<double> u(2);
  std::vector<std::vector<double>> given;
  for (int i = 0; i < controls; ++i) {
    // Noise of alternating sign.
    const std::vector<double> seen = {plant.x[0], plant.x[1] + (i % 2 == 0 ? noise : -noise)};
    const Step step = guided.Next(seen, u);
    trace.push_back(static_cast<double>(step.mode));
    trace.push_back(step.t);
    trace.insert(trace.end(), u.begin(), u.end());
    given.push_back(u);
    if (i >= late) plant.Apply(given[static_cast<std::size_t>(i - late)]);
    plant.x[1] += disturbance;
  }
  return trace;
}

TEST(GuidedControllerTest, TakingOutAPartChangesADecisionThatItIsThereFor) {
  const auto support = MovingDisk();
  const auto thirtyfold = ThirtyfoldDisk();
  const test::Task toppling(Thirtyfold(), thirtyfold, Toppling());
  const test::Task model(Identity(), support, Rightwards());
  const test::Task sideless(Identity(), support, Sideless());
  const auto along = test::ConstantPolicy(2, test::kSpeed);
  const auto back = test::ConstantPolicy(2, -test::kSpeed);
  std::vector<std::string_view> seen;
  for (const std::string_view part : GuidedPartNames()) {
    SCOPED_TRACE(part);
    const auto trace = [&](const GuidedOptions& options) -> std::vector<double> {
      if (part == "filter") return Trace(along, model, options, {0.0, 0.38}, 1);
      if (part == "drift") return Trace(along, toppling, options, {0.0, 0.38}, 1);
      if (part == "observer") return Trace(along, model, options, {0.0, 0.38}, 4, 0.0, 0.0, 1);
      if (part == "online-jacobian") return Trace(along, model, options, {0.0, 0.38}, 3, 0.9);
      if (part == "disturbance") return Trace(along, model, options, {0.0, 0.2}, 3, 0.0, 0.05);
      if (part == "demonstrated") return Trace(back, model, options, {0.0, 2.6}, 1);
      // exit-level: the point is 0.02 away from where it could be, with an object off to the side
      // that no control moves.
      if (part == "exit-level") {
        const test::GaussianSupport aside({{0.0, 0.0}}, 4.0, 0.38, {}, kSteps + 1);
        const test::Task at_edge(Identity(), aside, Rightwards(), {.slack = 0.2});
        GuidedOptions limited = options;
        limited.control_limit = {0.002};
        const test::FunctionPolicy outwards(2, 2,
                                            [](int, std::span<const double>, std::span<double> u) {
                                              u[0] = 0.0;
                                              u[1] = 0.002;
                                            });
        return Trace(outwards, at_edge, limited, {0.0, 0.55}, 1);
      }
      ADD_FAILURE() << "no situation for it";
      return {};
    };
    GuidedOptions options;
    if (part == "disturbance") options.disturbance_model = {.base = 1.0};
    EXPECT_NE(trace(options), trace(Without(options, part)));
    EXPECT_EQ(trace(options), trace(options)) << "the difference is the part's";
    seen.push_back(part);
  }
  EXPECT_THAT(seen, testing::ElementsAre("filter", "exit-level", "demonstrated", "online-jacobian",
                                         "drift", "observer", "disturbance"));
  // Further purposes of two of them: unused directions of control, and noise.
  EXPECT_NE(Trace(along, sideless, {}, {0.0, 0.6}, 1),
            Trace(along, sideless, Without({}, "online-jacobian"), {0.0, 0.6}, 1));
  EXPECT_NE(Trace(along, model, {}, {0.0, 0.3}, 8, 0.0, 0.0, 0, 0.1),
            Trace(along, model, Without({}, "observer"), {0.0, 0.3}, 8, 0.0, 0.0, 0, 0.1));
}

TEST(GuidedControllerTest, PartsAreTakenOutByTheirNeutralValues) {
  GuidedOptions options;
  options.disturbance_model = {.base = 1.0, .per_control = 2.0};
  options.horizon = 77;
  const GuidedOptions none = Without(options, "");
  EXPECT_EQ(none.iterations, options.iterations);
  EXPECT_EQ(none.disturbance_model.base, 1.0);
  const GuidedOptions two = Without(options, "filter+online-jacobian");
  EXPECT_EQ(two.iterations, 0);
  EXPECT_EQ(two.probe_size, 0.0);
  EXPECT_EQ(two.online_weight, 0.0);
  EXPECT_TRUE(two.demonstrated);
  EXPECT_TRUE(two.drift);
  EXPECT_TRUE(two.observer);
  EXPECT_EQ(two.horizon, 77);
  const GuidedOptions all = Without(options,
                                    "disturbance+observer+drift+online-jacobian+demonstrated+"
                                    "exit-level+filter");
  EXPECT_EQ(all.iterations, 0);
  EXPECT_FALSE(all.drift);
  EXPECT_FALSE(all.observer);
  EXPECT_EQ(all.max_exit_ratio, 0.0);
  EXPECT_FALSE(all.demonstrated);
  EXPECT_EQ(all.probe_size, 0.0);
  EXPECT_EQ(all.online_weight, 0.0);
  EXPECT_EQ(all.disturbance_model.base, 0.0);
  EXPECT_EQ(all.disturbance_model.per_control, 0.0);
  EXPECT_EQ(all.horizon, 77);
  // A controller can be made without these parts.
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto along = test::ConstantPolicy(2, test::kSpeed);
  GuidedController bare(along, model, all);
  bare.Reset(1);
  std::vector<double> u(2);
  EXPECT_EQ(bare.Next(std::vector{0.0, 0.38}, u).mode, Mode::kPolicy);
  EXPECT_NEAR(u[0], test::kSpeed, 1e-15);
  EXPECT_EQ(u[1], 0.0);
}

TEST(GuidedControllerTest, AnUnknownPartIsRefusedWithTheNamesOfAll) {
  for (const char* parts : {"Filter", "filter+nothing", "+filter", "filter time"}) {
    SCOPED_TRACE(parts);
    try {
      (void)Without({}, parts);
      ADD_FAILURE() << "nothing thrown";
    } catch (const std::invalid_argument& e) {
      for (const std::string_view name : GuidedPartNames()) {
        EXPECT_THAT(e.what(), HasSubstr(std::string(name)));
      }
    }
  }
}

TEST(GuidedControllerTest, ControlsStayWithinThePlantsLimit) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 7.0);
  GuidedController guided(policy, model, {.control_limit = {0.05}});
  core::Random random(1);
  std::vector<double> u(2);
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    guided.Reset(seed);
    const std::vector<double> x = {random.Uniform(-1, 1), random.Uniform(-1, 1)};
    for (int i = 0; i < 5; ++i) {
      if (guided.Next(x, u).mode == Mode::kHalt) break;
      for (const double entry : u) ASSERT_LE(std::abs(entry), 0.05 * (1.0 + 1e-12));
    }
  }
}

// Episodes are deterministic and independent of earlier ones.
TEST(GuidedControllerTest, TheSameStatesGiveTheSameControls) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Sideless());
  const auto policy = test::ConstantPolicy(2, 0.1);
  GuidedController guided(policy, model);
  const auto controls = [&](std::uint64_t seed) {
    guided.Reset(seed);
    Turned plant{.x = {0.0, 0.3}};
    std::vector<double> all, u(2);
    for (int i = 0; i < 10; ++i) {
      (void)guided.Next(plant.x, u);
      all.insert(all.end(), u.begin(), u.end());
      plant.Apply(u);
    }
    return all;
  };
  const auto first = controls(1);
  EXPECT_EQ(controls(1), first);
  EXPECT_EQ(controls(2), first);
}

TEST(GuidedControllerTest, HaltsAtEveryDoubt) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  std::vector<double> u(2);
  const auto nothing = test::ConstantPolicy(2, std::nan(""));
  GuidedController guided(nothing, model);
  EXPECT_EQ(guided.Next(std::vector{0.0, 0.0}, u).cause, HaltCause::kNotReset);
  guided.Reset(1);
  EXPECT_EQ(guided.Next(std::vector{0.0, 0.0}, u).cause, HaltCause::kControlInvalid);
  guided.Reset(1);
  EXPECT_EQ(guided.Next(std::vector{0.0, std::nan("")}, u).cause, HaltCause::kStateInvalid);
  guided.Reset(1);
  EXPECT_EQ(guided.Next(std::vector{1e200, 0.0}, u).cause, HaltCause::kSupportInvalid);
}

TEST(GuidedControllerTest, NextNeverAllocates) {
  const auto support = MovingDisk();
  const test::Task model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.1);
  GuidedController guided(policy, model, {.disturbance_model = {.base = 0.5, .per_control = 1.0}});
  core::Random random(1);
  std::vector<double> x(2), u(2);
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

TEST(GuidedControllerTest, ErrorsNameTheCulprit) {
  const auto support = MovingDisk();
  const auto message = [&](const GuidedOptions& options, int control_dim = 2) -> std::string {
    const test::Task model(Identity(), support, Rightwards());
    const test::FunctionPolicy policy(2, control_dim,
                                      [](int, std::span<const double>, std::span<double>) {});
    try {
      GuidedController guided(policy, model, options);
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  EXPECT_THAT(message({}, 3), HasSubstr("3 control entries"));
  EXPECT_THAT(message({.horizon = 0}), HasSubstr("horizon"));
  EXPECT_THAT(message({.max_controls = 0}), HasSubstr("max_controls"));
  EXPECT_THAT(message({.control_limit = {-1.0}}), HasSubstr("control_limit"));
  EXPECT_THAT(message({.disturbance_model = {.base = -1.0}}), HasSubstr("disturbance_model"));
  EXPECT_THAT(message({.first_step = -1}), HasSubstr("first_step"));
  EXPECT_THAT(message({.iterations = -1}), HasSubstr("iterations"));
  EXPECT_THAT(message({.max_exit_ratio = -0.1}), HasSubstr("max_exit_ratio"));
  EXPECT_THAT(message({.max_exit_ratio = -1.0}), HasSubstr("max_exit_ratio"));
  EXPECT_THAT(message({.patience = 0}), HasSubstr("patience"));
  EXPECT_THAT(message({.probe_size = -0.1}), HasSubstr("probe_size"));
  EXPECT_THAT(message({.online_weight = -1.0}), HasSubstr("online_weight"));
  EXPECT_THAT(message({.online_weight = std::nan("")}), HasSubstr("online_weight"));
  EXPECT_THROW(test::Task(Identity(), support, {}), std::invalid_argument);
  EXPECT_THROW(test::Task(Identity(), support, Rightwards(), {.slack = -0.1}),
               std::invalid_argument);
}

}  // namespace
}  // namespace dfr::control
