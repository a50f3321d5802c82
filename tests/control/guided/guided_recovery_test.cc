#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/control/guided/guided_controller.h"
#include "tests/control/analytic.h"
#include "tests/control/rightwards.h"
#include "tests/support/message_of.h"

namespace dfr::control {
namespace {

using testing::HasSubstr;

using test::kSteps;
using test::MovingDisk;
using test::Rightwards;
using Turned = test::TurnedPoint;

class GuidedRecoveryTest : public test::RightwardsTest {};

// No control moves the third entry of the state, an object off to the side. The best attainable
// level is l = -0.3.
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
using GuidedRecoverySlackTest = Aside;

// If no control can correct the state, the best control passes within an exit level of twice the
// slack. Beyond that level, recoveries apply the demonstrated controls, and the phase skips
// supports that they miss.
TEST_F(GuidedRecoverySlackTest, TheBestControlPassesWithinTheExitLevelAndTheDemonstratedOneBeyond) {
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
    // Demonstrations approach y = 0 by y' = 0.7 y + noise. A regression over about 130 transitions
    // has the standard error noise / sqrt(130), and the error of y is 1 / 0.3 times as large. The
    // limit is three standard errors.
    EXPECT_NEAR(x[1], 0.0, 3.0 * 0.05 / std::sqrt(130.0) / 0.3);
  }
}

// The object is too far to the side. Ascent would end at B_1's centre, but the demonstrated
// control, to the right, is applied. Its y component is shrunk by the regression's ridge, because
// these features are far smaller than whitened ones.
TEST_F(GuidedRecoverySlackTest, ARecoveryThatStaysOutsideAppliesTheDemonstratedControl) {
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

// Returns the modes of decisions in one state: neither the support nor the point ever moves.
std::string Modes(double y, const GuidedOptions& options) {
  const test::GaussianSupport support({{0.0, 0.0}}, 4.0, 0.5);
  const test::Task model(test::IdentityFeatures(), support, Rightwards());
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

TEST_F(GuidedRecoveryTest, HaltsOutsideAfterItsPatience) {
  EXPECT_EQ(Modes(2.5, {}), "RRRRRRRRRRRR no-progress");
  EXPECT_EQ(Modes(2.5, {.patience = 5}), "RRRRR no-progress");
}

// A point starts above the path. Demonstrated controls carry it past the supports at x = t
// test::kSpeed. The phase advances with the prediction and skips the missed supports.
TEST_F(GuidedRecoveryTest, ThePhaseSkipsSupportsThatARecoveryMisses) {
  // Demonstrations have constant y and contain no motion down.
  auto demonstrations = Rightwards();
  for (auto& d : demonstrations) {
    d.states.col(1).setConstant(d.states(0, 1));
    d.controls.col(1).setZero();
  }
  const test::Task level(test::IdentityFeatures(), support, demonstrations);
  const auto still = test::ConstantPolicy(2, 0.0);
  GuidedController guided(still, level, {.probe_size = 0.0});
  guided.Reset(1);
  std::vector<double> x = {0.0, 1.0};
  Step step = guided.Next(x, u);
  for (int i = 1; i < kSteps && step.mode != Mode::kHalt; ++i) {
    x[0] += u[0];  // No control moves it down.
    step = guided.Next(x, u);
  }
  EXPECT_EQ(step.mode, Mode::kRecovery);
  EXPECT_GE(step.t, kSteps / 2);
}

TEST_F(GuidedRecoveryTest, ComesBackFromOutside) {
  const test::Task turned(test::IdentityFeatures(), support, Rightwards(0.7));
  const auto still = test::ConstantPolicy(2, 0.0);
  Turned plant{.angle = 0.7, .x = {0.0, 1.5}};
  ASSERT_LT(support.Decision(0, plant.x), -0.4) << "so far out that g is flat";
  GuidedController guided(still, turned);
  guided.Reset(1);
  int controls = 0;
  while (support.Decision(0, plant.x) < 0.0 && controls < 10) {
    ASSERT_NE(guided.Next(plant.x, u).mode, Mode::kHalt) << controls;
    plant.Apply(u);
    ++controls;
  }
  EXPECT_LT(controls, 10);
}

// Demonstrations without sideways controls. They contain no effect of the control's second entry.
std::vector<core::Trajectory> Sideless() {
  auto demonstrations = Rightwards();
  for (auto& d : demonstrations) d.controls.col(1).setZero();
  return demonstrations;
}

TEST_F(GuidedRecoveryTest, ProbesADirectionWithoutDemonstratedControls) {
  const test::Task sideless(test::IdentityFeatures(), support, Sideless());
  const auto along = test::ConstantPolicy(2, test::kSpeed);
  const std::vector<double> x = {0.0, 0.6};  // beyond the exit level
  GuidedController guided(along, sideless);
  Step step = First(guided, x);
  EXPECT_EQ(step.mode, Mode::kProbe);
  EXPECT_FALSE(step.filtered);
  EXPECT_GT(std::abs(u[1]), 10.0 * std::abs(u[0]));
  EXPECT_NEAR(test::Norm(u), 0.35 * sideless.response.control_unit(), 1e-12);
  // No second probe follows in a direction that was already probed.
  step = guided.Next(std::vector{x[0] + u[0], x[1] + u[1]}, u);
  EXPECT_NE(step.mode, Mode::kProbe);

  GuidedController never(along, sideless, {.probe_size = 0.0});
  EXPECT_NE(First(never, x).mode, Mode::kProbe);
  // No probe follows if the response is known or the prediction is inside. With a disturbance model
  // an inside prediction is not sufficient.
  GuidedController knows(along, model);
  EXPECT_EQ(First(knows, x).mode, Mode::kRecovery);
  const std::vector<double> inside = {0.0, 0.35};
  EXPECT_NE(First(guided, inside).mode, Mode::kProbe);
  GuidedController disturbed(along, sideless, {.disturbance_model = {.base = 1.0}});
  EXPECT_EQ(First(disturbed, inside).mode, Mode::kProbe);
  EXPECT_EQ(First(disturbed, {0.0, 0.0}).mode, Mode::kPolicy) << "deep inside";
}

// A disturbance moves the point sideways by more than a probe does, in a direction without
// demonstrated controls. A controller that mistakes the disturbance for the probe's effect steers
// the wrong way. A controller that estimates the disturbance stays on the path.
TEST_F(GuidedRecoveryTest, StaysOnItsPathUnderADisturbance) {
  constexpr double kDisturbance = 0.06;  // a probe is 0.035
  const test::Task sideless(test::IdentityFeatures(), support, Sideless(), {.gate_quantile = 0.5});
  const auto rightwards = test::ConstantPolicy(2, 0.1);
  const auto farthest = [&](const DisturbanceModel& disturbance_model, double sign) {
    // Removes two parts. The exit level would let the disturbance carry the state away. The nominal
    // control would lead back without an estimate of J.
    GuidedOptions options = Without({}, "exit-level+demonstrated");
    options.horizon = 60;
    options.disturbance_model = disturbance_model;
    GuidedController guided(rightwards, sideless, options);
    guided.Reset(1);
    std::vector<double> x = {0.0, 0.0};
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
    // Attributing half of the duration to the control's norm is accurate enough.
    aware = std::max(aware, farthest({.base = 0.5, .per_control = 0.5}, sign));
  }
  EXPECT_LT(aware, 0.2) << "two steps of the disturbance, a probe, and the rest of J's error";
  EXPECT_GT(std::max(farthest({}, 1.0), farthest({}, -1.0)), 1.5 * aware);
}

// Demonstrations of a plant that drifts away from y = 0. Their controls counteract the drift.
std::vector<core::Trajectory> Toppling() {
  auto demonstrations = Rightwards();
  for (core::Trajectory& demonstration : demonstrations) {
    for (Eigen::Index t = 0; t < demonstration.controls.rows(); ++t) {
      demonstration.controls(t, 1) -= 0.9 * demonstration.states(t, 1);
    }
  }
  return demonstrations;
}
// Features with the spread of whitened ones. ThirtyfoldDisk() is MovingDisk() in these features.
core::FeatureTransform Thirtyfold() {
  return {core::FeatureSelection::All(2), Eigen::Vector2d::Zero(),
          30.0 * core::Matrix::Identity(2, 2)};
}
test::GaussianSupport ThirtyfoldDisk() {
  return {{{0.0, 0.0}}, 4.0 / 900.0, 0.5, {30.0 * test::kSpeed, 0.0}, kSteps + 1};
}

// Runs a controller on a plant and returns its modes, time steps and controls.
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

TEST_F(GuidedRecoveryTest, RemovingAPartChangesADecision) {
  const auto thirtyfold = ThirtyfoldDisk();
  const test::Task toppling(Thirtyfold(), thirtyfold, Toppling());
  const test::Task sideless(test::IdentityFeatures(), support, Sideless());
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
      // exit-level: the point is outside by less than the exit level, and the control limit is too
      // small to bring it back.
      if (part == "exit-level") {
        const test::GaussianSupport aside({{0.0, 0.0}}, 4.0, 0.38, {}, kSteps + 1);
        const test::Task at_edge(test::IdentityFeatures(), aside, Rightwards(), {.slack = 0.2});
        GuidedOptions limited = options;
        limited.control_limit = {0.002};
        const test::FunctionPolicy outwards(
            2, 2, [](int, std::span<const double>, std::span<double> learned) {
              learned[0] = 0.0;
              learned[1] = 0.002;
            });
        return Trace(outwards, at_edge, limited, {0.0, 0.55}, 1);
      }
      ADD_FAILURE() << "no situation for this part";
      return {};
    };
    GuidedOptions options;
    if (part == "disturbance") options.disturbance_model = {.base = 1.0};
    EXPECT_NE(trace(options), trace(Without(options, part)));
    EXPECT_EQ(trace(options), trace(Without(options, ""))) << "only the part makes the difference";
    seen.push_back(part);
  }
  EXPECT_THAT(seen, testing::ElementsAre("filter", "exit-level", "demonstrated", "online-jacobian",
                                         "drift", "observer", "disturbance"));
  // The part online-jacobian also probes unused directions of control. The part observer also
  // suppresses noise.
  EXPECT_NE(Trace(along, sideless, {}, {0.0, 0.6}, 1),
            Trace(along, sideless, Without({}, "online-jacobian"), {0.0, 0.6}, 1));
  EXPECT_NE(Trace(along, model, {}, {0.0, 0.3}, 8, 0.0, 0.0, 0, 0.1),
            Trace(along, model, Without({}, "observer"), {0.0, 0.3}, 8, 0.0, 0.0, 0, 0.1));
}

TEST_F(GuidedRecoveryTest, WithoutAllPartsTheLearnedControlPasses) {
  std::string all;
  for (const std::string_view part : GuidedPartNames()) {
    all += (all.empty() ? "" : "+") + std::string(part);
  }
  const auto along = test::ConstantPolicy(2, test::kSpeed);
  GuidedController bare(along, model, Without({}, all));
  EXPECT_EQ(First(bare, {0.0, 0.38}).mode, Mode::kPolicy);
  EXPECT_NEAR(u[0], test::kSpeed, 1e-15);
  EXPECT_EQ(u[1], 0.0);
}

TEST(GuidedPartsTest, AnUnknownPartIsRefusedWithTheValidNames) {
  for (const char* parts : {"Filter", "filter+nothing", "+filter", "filter time"}) {
    SCOPED_TRACE(parts);
    const std::string message =
        test::MessageOf<std::invalid_argument>([&] { (void)Without({}, parts); });
    for (const std::string_view name : GuidedPartNames()) {
      EXPECT_THAT(message, HasSubstr(std::string(name)));
    }
  }
}

// Episodes are deterministic and independent of earlier ones.
TEST_F(GuidedRecoveryTest, TheSameStatesGiveTheSameControls) {
  const test::Task sideless(test::IdentityFeatures(), support, Sideless());
  const auto policy = test::ConstantPolicy(2, 0.1);
  GuidedController guided(policy, sideless);
  const auto controls = [&](std::uint64_t seed) {
    guided.Reset(seed);
    Turned plant{.x = {0.0, 0.3}};
    std::vector<double> all;
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

// Beyond the exit level, controls that lead away from all demonstrations end the episode early. The
// controller waits for a state that rests, moves along the demonstrations, returns once, or is near
// demonstrated states of another phase.
TEST_F(GuidedRecoveryTest, HaltsAfterFourControlsThatLeadAway) {
  const auto policy = test::ConstantPolicy(2, 0.0);
  const auto controls = [&](bool least, double dx, double dy, int back) {
    GuidedController guided(policy, model, {.least_intervention = least, .observer = false});
    guided.Reset(1);
    std::vector<double> x = {0.0, 2.0};
    int applied = 0;
    while (guided.Next(x, u).mode != Mode::kHalt) {
      ++applied;
      const double sign = applied == back ? -1.0 : 1.0;
      x = {x[0] + sign * dx, x[1] + sign * dy};
    }
    EXPECT_EQ(guided.halt_cause(), HaltCause::kNoProgress);
    return applied;
  };
  constexpr int kPatience = GuidedOptions{}.patience;
  for (const bool least : {false, true}) {
    EXPECT_EQ(controls(least, 0.0, 0.05, 0), guided::kMostAway);
    EXPECT_EQ(controls(least, -0.01, 0.05, 3), guided::kMostAway + 3)
        << "the third control returns";
    EXPECT_GE(controls(least, 0.05, 0.02, 0), kPatience) << "past demonstrations, slightly away";
    EXPECT_GE(controls(least, 0.0, 0.0, 0), kPatience);
    EXPECT_GE(controls(least, 0.0, -0.01, 0), kPatience);
  }
}

}  // namespace
}  // namespace dfr::control
