#include "dfr/control/guided_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/control/switching_policy.h"
#include "tests/control/analytic.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

using testing::HasSubstr;

constexpr double kSpeed = 0.1;
constexpr int kSteps = 20;

// Demonstrations of a point that goes right at kSpeed a step, y scattered; the control is the
// change of state, but turned by `angle`.
std::vector<core::Trajectory> Rightwards(double angle = 0.0) {
  core::Random random(1);
  std::vector<core::Trajectory> demonstrations;
  for (int d = 0; d < 30; ++d) {
    core::Trajectory trajectory;
    trajectory.states.resize(kSteps + 1, 2);
    trajectory.controls.resize(kSteps, 2);
    trajectory.states.row(0) << 0.05 * random.Normal(), 0.1 * random.Normal();
    for (int t = 0; t < kSteps; ++t) {
      const double dx = kSpeed;
      const double dy = -0.3 * trajectory.states(t, 1) + 0.05 * random.Normal();
      trajectory.states.row(t + 1) = trajectory.states.row(t) + Eigen::RowVector2d(dx, dy);
      trajectory.controls.row(t) << std::cos(angle) * dx + std::sin(angle) * dy,
          -std::sin(angle) * dx + std::cos(angle) * dy;
    }
    demonstrations.push_back(trajectory);
  }
  return demonstrations;
}

// B_t is a disk of radius 0.42 around (t kSpeed, 0).
test::GaussianSupport Moving() { return {{{0.0, 0.0}}, 4.0, 0.5, {kSpeed, 0.0}, kSteps + 1}; }

core::FeatureTransform Identity() {
  return core::FeatureTransform::Identity(core::FeatureSelection::All(2));
}

// A point whose control is turned by `angle`, in the way that Rightwards() was.
struct Turned {
  double angle = 0.0;
  std::vector<double> x = {0.0, 0.0};
  void Apply(const std::vector<double>& u) {
    x[0] += std::cos(angle) * u[0] - std::sin(angle) * u[1];
    x[1] += std::sin(angle) * u[0] + std::cos(angle) * u[1];
  }
};

TEST(GuidedPolicyTest, PassesTheLearnedControlDeepInside) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.08);
  GuidedPolicy guided(policy, model);
  guided.Reset(1);
  std::vector<double> u(2);
  const Step step = guided.Next(std::vector{0.05, 0.0}, u);
  EXPECT_EQ(step.mode, Mode::kPolicy);
  EXPECT_FALSE(step.filtered);
  EXPECT_NEAR(u[0], 0.08, 1e-16);  // to the control unit and back
  EXPECT_EQ(u[1], 0.0);
  EXPECT_GE(step.log_g, step.threshold);
}

// A policy that runs off the corridor sideways is changed so that the next state keeps its level,
// and still gets on.
TEST(GuidedPolicyTest, FilterKeepsAWrongPolicyInsideAndMoving) {
  for (const double angle : {0.0, 0.9, -2.0}) {
    SCOPED_TRACE(angle);
    const auto support = Moving();
    const GuidedModel model(Identity(), support, Rightwards(angle));
    const test::FunctionPolicy policy(2, 2,
                                      [angle](int, std::span<const double>, std::span<double> u) {
                                        const double dx = 0.09, dy = 0.06;
                                        u[0] = std::cos(angle) * dx + std::sin(angle) * dy;
                                        u[1] = -std::sin(angle) * dx + std::cos(angle) * dy;
                                      });
    Turned plant{.angle = angle};
    GuidedPolicy guided(policy, model, {.horizon = 40});
    guided.Reset(1);
    std::vector<double> u(2);
    int filtered = 0;
    int controls = 0;
    while (plant.x[0] < 1.8 && controls < 60) {
      const Step step = guided.Next(plant.x, u);
      ASSERT_NE(step.mode, Mode::kHalt) << Name(step.cause) << " at x = " << plant.x[0];
      plant.Apply(u);
      filtered += step.filtered ? 1 : 0;
      ++controls;
      ASSERT_LT(std::abs(plant.x[1]), 0.42) << "the half width of every B_t";
    }
    EXPECT_GE(plant.x[0], 1.8);
    EXPECT_GT(filtered, 0);
  }
}

TEST(GuidedPolicyTest, ComesBackFromOutsideUnlessReentryIsOff) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards(0.7));
  const auto still = test::ConstantPolicy(2, 0.0);
  Turned plant{.angle = 0.7, .x = {0.0, 1.5}};
  ASSERT_LT(support.Decision(0, plant.x), -0.4) << "so far out that g is flat";
  GuidedPolicy guided(still, model);
  guided.Reset(1);
  std::vector<double> u(2);
  int controls = 0;
  while (support.Decision(0, plant.x) < 0.0 && controls < 40) {
    ASSERT_NE(guided.Next(plant.x, u).mode, Mode::kHalt) << controls;
    plant.Apply(u);
    ++controls;
  }
  EXPECT_LT(controls, 40);

  GuidedOptions options;
  options.parts.reentry = false;
  GuidedPolicy stays(still, model, options);
  stays.Reset(1);
  EXPECT_EQ(stays.Next(std::vector{0.0, 1.5}, u).cause, HaltCause::kOutsideSupport);
}

// A controller that takes over in mid-task looks for its phase there.
TEST(GuidedPolicyTest, BeginsAtTheFirstStepItIsGiven) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.08);
  std::vector<double> u(2);
  GuidedPolicy guided(policy, model, {.horizon = 20, .first_step = 12});
  guided.Reset(1);
  const Step step = guided.Next(std::vector{12 * kSpeed, 0.0}, u);
  EXPECT_EQ(step.t, 12);
  EXPECT_EQ(step.mode, Mode::kPolicy);
  SwitchingPolicy dfr(policy, support, 0.01, {.horizon = 20, .first_step = 12});
  dfr.Reset(1);
  EXPECT_EQ(dfr.Next(std::vector{12 * kSpeed, 0.0}, u).t, 12);
  EXPECT_THROW(GuidedPolicy(policy, model, {.horizon = 20, .first_step = 20}),
               std::invalid_argument);
  EXPECT_THROW(SwitchingPolicy(policy, support, 0.01, {.horizon = 20, .first_step = -1}),
               std::invalid_argument);
}

// A third entry of the state, an object off to the side, that no control moves: the best that can
// be reached is l = -0.3. A slack of as much goes on, and keeps the rest at its best; less holds.
TEST(GuidedPolicyTest, SlackGoesOnWithWhatNoControlCanMend) {
  const test::GaussianSupport support({{0.0, 0.0, 0.0}}, 4.0, 0.5, {kSpeed, 0.0, 0.0}, kSteps + 1);
  std::vector<core::Trajectory> demonstrations = Rightwards();
  for (core::Trajectory& d : demonstrations) {
    d.states.conservativeResize(Eigen::NoChange, 3);
    d.states.col(2).setZero();
  }
  const core::FeatureTransform features =
      core::FeatureTransform::Identity(core::FeatureSelection::All(3));
  const auto policy = test::FunctionPolicy(3, 2, [](int, std::span<const double>, auto u) {
    u[0] = kSpeed;
    u[1] = 0.0;
  });
  const double offset = std::sqrt((0.3 - std::log(0.5)) / 4.0);  // -4 offset^2 - log 0.5 = -0.3
  for (const double slack : {0.25, 0.35}) {
    SCOPED_TRACE(slack);
    const GuidedModel model(features, support, demonstrations, {.slack = slack});
    GuidedPolicy guided(policy, model);
    guided.Reset(1);
    std::vector<double> u(2), x = {0.0, 0.0, offset};
    Step step;
    for (int i = 0; i < kSteps; ++i) {
      step = guided.Next(x, u);
      if (step.mode == Mode::kHalt) break;
      x[0] += u[0];
      x[1] += u[1];
    }
    if (slack < 0.3) {
      EXPECT_EQ(step.cause, HaltCause::kNoProgress);
      EXPECT_LT(x[0], 3 * kSpeed);
    } else {
      EXPECT_NEAR(x[0], kSteps * kSpeed, 2 * kSpeed) << "one step of the task after another";
      EXPECT_LT(std::abs(x[1]), 0.1);
    }
  }
}

TEST(GuidedModelTest, SlackIsWhatUnseenDemonstrationsNeed) {
  std::vector<double> levels;
  for (int i = 0; i <= 100; ++i) levels.push_back(0.5 - 0.02 * i);  // 0.5 ... -1.5
  EXPECT_NEAR(SlackFrom(levels), 1.1, 1e-12);                       // the 0.2-quantile
  EXPECT_EQ(SlackFrom({0.1, 0.2, 0.3}), GuidedModelOptions().slack) << "never less";
  EXPECT_THROW((void)SlackFrom({}), std::invalid_argument);
}

// Where no control changes anything there is nothing to gain, and it stops in the end.
TEST(GuidedPolicyTest, HoldsWhereNothingHelps) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.1);
  const std::vector<double> stuck = {0.0, 0.6};
  GuidedPolicy guided(policy, model);
  guided.Reset(1);
  std::vector<double> u(2);
  int controls = 0;
  Step step;
  do {
    step = guided.Next(stuck, u);
    ++controls;
  } while (step.mode != Mode::kHalt && controls < 1000);
  EXPECT_TRUE(step.cause == HaltCause::kNoProgress || step.cause == HaltCause::kIterationLimit);
  EXPECT_LE(controls, 41);
}

TEST(GuidedPolicyTest, ProbesAControlThatNobodyHasEverUsed) {
  auto demonstrations = Rightwards();
  for (auto& d : demonstrations) d.controls.col(1).setZero();
  const auto support = Moving();
  const GuidedModel model(Identity(), support, demonstrations);
  const auto away = test::ConstantPolicy(2, -0.1);
  for (const bool probing : {true, false}) {
    GuidedOptions options;
    options.parts.probing = probing;
    options.parts.filter = false;
    GuidedPolicy guided(away, model, options);
    guided.Reset(1);
    std::vector<double> u(2);
    const Step step = guided.Next(std::vector{0.0, 0.35}, u);
    EXPECT_EQ(step.mode, probing ? Mode::kProbe : Mode::kRecovery);
    if (probing) {
      EXPECT_GT(std::abs(u[1]), 10.0 * std::abs(u[0]));
    }
  }
}

// The world drifts sideways by more than a probe moves it, which nobody ever did on purpose. Who
// takes the drift for the probe's effect steers the wrong way; who knows that time passes does not.
TEST(GuidedPolicyTest, HoldsItsPlaceInADrift) {
  constexpr double kDrift = 0.06;  // a probe is 0.035
  auto demonstrations = Rightwards();
  for (auto& d : demonstrations) d.controls.col(1).setZero();
  const auto support = Moving();
  const GuidedModel model(Identity(), support, demonstrations);
  const auto rightwards = test::FunctionPolicy(
      2, 2, [](int, std::span<const double>, std::span<double> u) { u[0] = 0.1, u[1] = 0.0; });
  const auto farthest = [&](const DriftTime& drift_time, double sign) {
    GuidedOptions options;
    options.horizon = 60;
    options.drift_time = drift_time;
    // Content with what lies outside, it would be carried off.
    options.parts.slack = false;
    options.parts.gentle_outside = false;
    GuidedPolicy guided(rightwards, model, options);
    guided.Reset(1);
    std::vector<double> x = {0.0, 0.0};
    std::vector<double> u(2);
    double y = 0.0;
    for (int controls = 0; x[0] < 1.8; ++controls) {
      if (controls == 60 || guided.Next(x, u).mode == Mode::kHalt) return 1.0;
      x[0] += u[0];
      x[1] += u[1] + sign * kDrift;
      y = std::max(y, std::abs(x[1]));
    }
    return y;
  };
  for (const double sign : {1.0, -1.0}) {
    EXPECT_LT(farthest({.rest = 1.0}, sign), 0.42) << "the half width of every B_t";
    // Half of it known as time that a control's travel takes is near enough.
    EXPECT_LT(farthest({.rest = 0.5, .travel = 0.5}, sign), 0.42);
  }
  EXPECT_GT(std::max(farthest({}, 1.0), farthest({}, -1.0)), 0.42);
}

// A policy at a third of the demonstrated speed falls behind: the next phase's margin is out of
// reach, but getting on within the present one is not, and recoveries become fewer.
TEST(GuidedPolicyTest, HoldsThePhaseForAPolicyThatIsLate) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto slow = test::ConstantPolicy(2, kSpeed / 3.0);
  const auto recoveries = [&](bool hold) {
    GuidedOptions options;
    options.parts.phase_hold = hold;
    options.parts.realignment = false;
    options.parts.slack = false;
    options.control_limit = kSpeed / 3.0;
    Turned plant;
    GuidedPolicy guided(slow, model, options);
    guided.Reset(1);
    std::vector<double> u(2);
    int count = 0;
    while (plant.x[0] < 1.5) {
      const Step step = guided.Next(plant.x, u);
      if (step.mode == Mode::kHalt) {
        ADD_FAILURE() << Name(step.cause) << " at x = " << plant.x[0];
        break;
      }
      count += step.mode == Mode::kPolicy ? 0 : 1;
      plant.Apply(u);
      EXPECT_LT(std::abs(plant.x[1]), 0.42) << "the half width of every B_t";
    }
    return count;
  };
  EXPECT_LT(recoveries(true), recoveries(false));
}

// Where the supports of some phases are somewhere else entirely, the phases after them are found.
TEST(GuidedPolicyTest, SearchesForAPhaseBeyondThoseThatCannotBeReached) {
  class Gap final : public core::LogDecisionFunction {
   public:
    int state_dim() const noexcept override { return 2; }
    int num_steps() const noexcept override { return support_.num_steps(); }
    double Decision(int t, std::span<const double> x) const noexcept override {
      return support_.Decision(t, Moved(t, x));
    }
    double Gradient(int t, std::span<const double> x,
                    std::span<double> gradient) const noexcept override {
      return support_.Gradient(t, Moved(t, x), gradient);
    }
    double LogDecision(int t, std::span<const double> x,
                       std::span<double> gradient) const noexcept override {
      return support_.LogDecision(t, Moved(t, x), gradient);
    }
    double lipschitz_bound(int t) const noexcept override { return support_.lipschitz_bound(t); }
    double curvature_bound(int t) const noexcept override { return support_.curvature_bound(t); }

   private:
    static std::array<double, 2> Moved(int t, std::span<const double> x) noexcept {
      return {x[0], x[1] + (t >= 8 && t < 12 ? 3.0 : 0.0)};
    }
    test::GaussianSupport support_ = Moving();
  };
  const Gap support;
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, kSpeed);
  for (const bool search : {true, false}) {
    SCOPED_TRACE(search);
    GuidedOptions options;
    options.parts.phase_search = search;
    Turned plant;
    GuidedPolicy guided(policy, model, options);
    guided.Reset(1);
    std::vector<double> u(2);
    bool halted = false;
    for (int i = 0; i < 200 && plant.x[0] < 1.8 && !halted; ++i) {
      halted = guided.Next(plant.x, u).mode == Mode::kHalt;
      plant.Apply(u);
    }
    EXPECT_EQ(plant.x[0] >= 1.8, search) << plant.x[0];
  }
}

TEST(GuidedPolicyTest, EveryPartCanBeSwitchedOffAndHasAName) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.1);
  EXPECT_EQ(GuidedPartNames().size(), 14u);
  for (const GuidedPartName& part : GuidedPartNames()) {
    SCOPED_TRACE(part.name);
    GuidedOptions options;
    ASSERT_TRUE(options.parts.*part.part);
    options.parts.*part.part = false;
    // Half a step ahead: as deep inside B_t as inside B_{t+1}.
    Turned plant{.x = {0.05, 0.0}};
    GuidedPolicy guided(policy, model, options);
    guided.Reset(1);
    std::vector<double> u(2);
    for (int i = 0; i < 15; ++i) {
      ASSERT_NE(guided.Next(plant.x, u).mode, Mode::kHalt) << i;
      plant.Apply(u);
    }
  }
}

TEST(GuidedPolicyTest, ControlsStayWithinThePlantsLimit) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 7.0);
  GuidedPolicy guided(policy, model, {.control_limit = 0.05});
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

// The assumption |dz| <= K |u| is watched: a plant with a larger gain than promised is stopped
// after the first control that shows it.
TEST(GuidedPolicyTest, CertifiedModesHaltAtTheFirstViolation) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.05);
  for (const auto kind :
       {CertificateKind::kLipschitz, CertificateKind::kRadius, CertificateKind::kDirection}) {
    SCOPED_TRACE(Name(kind));
    GuidedOptions options;
    options.certificate = {kind, 1.0, 0.1};
    GuidedPolicy guided(policy, model, options);
    guided.Reset(1);
    std::vector<double> x = {0.0, 0.0}, u(2);
    for (int i = 0; i < 2; ++i) {
      const Step step = guided.Next(x, u);
      ASSERT_NE(step.mode, Mode::kHalt);
      EXPECT_TRUE(step.certified);
      // The first control does as promised, the second twice as much.
      for (std::size_t k = 0; k < 2; ++k) x[k] += (i == 0 ? 1.0 : 2.0) * u[k];
    }
    EXPECT_EQ(guided.Next(x, u).cause, HaltCause::kViolated);
    EXPECT_EQ(guided.violation().control, 1);
    EXPECT_GT(guided.violation().observed, guided.violation().allowed);
  }
}

TEST(GuidedPolicyTest, CertifiedModesHaltOutside) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.05);
  GuidedOptions options;
  options.certificate = {CertificateKind::kRadius, 1.0, 0.0};
  GuidedPolicy guided(policy, model, options);
  guided.Reset(1);
  std::vector<double> u(2);
  EXPECT_EQ(guided.Next(std::vector{0.0, 2.0}, u).cause, HaltCause::kOutsideSupport);
}

// g_t(x) = exp(-(x - c_t)^2) - 0.5 with c_0 = 0, c_1 = 1, K = 1: at x = -0.6 the published gate
// g_0(x) > L K |u| lets u = 0.001 pass, whatever its direction, and the state is then outside B_1,
// which the proof by induction excludes. The phase is held instead.
TEST(Proposition1Test, ThePublishedGateLeavesItsOwnInvariantAndPhaseHoldKeepsIt) {
  const test::GaussianSupport support({{0.0}}, 1.0, 0.5, {1.0}, 2);
  const auto policy = test::ConstantPolicy(1, 0.001);
  std::vector<double> x = {-0.6}, u(1);
  SwitchingPolicy published(policy, support, support.lipschitz_bound(0));
  published.Reset(1);
  ASSERT_EQ(published.Next(x, u).mode, Mode::kPolicy);
  x[0] += u[0];
  EXPECT_NEAR(support.Decision(1, x), -0.422, 1e-3);
  EXPECT_EQ(published.Next(x, u).cause, HaltCause::kOutsideSupport);

  std::vector<core::Trajectory> demonstrations(2);
  for (std::size_t d = 0; d < 2; ++d) {
    demonstrations[d].states.resize(2, 1);
    demonstrations[d].states << 0.0 + 0.1 * static_cast<double>(d), 1.0;
    demonstrations[d].controls.resize(1, 1);
    demonstrations[d].controls << 1.0;
  }
  const GuidedModel model(core::FeatureTransform::Identity(core::FeatureSelection::All(1)), support,
                          demonstrations);
  for (const auto kind :
       {CertificateKind::kLipschitz, CertificateKind::kRadius, CertificateKind::kDirection}) {
    SCOPED_TRACE(Name(kind));
    GuidedOptions options;
    options.certificate = {kind, 1.0, 1.0};
    GuidedPolicy held(policy, model, options);
    held.Reset(1);
    x = {-0.6};
    for (int i = 0; i < 50; ++i) {
      const Step step = held.Next(x, u);
      if (step.mode == Mode::kHalt) {
        ASSERT_EQ(step.cause, HaltCause::kNoProgress);
        break;
      }
      ASSERT_GE(support.Decision(step.t, x), 0.0) << "the phase is one that holds the state";
      x[0] += u[0];
      ASSERT_GE(std::max(support.Decision(0, x), support.Decision(1, x)), 0.0);
    }
  }
}

// Prop. IV.3 with its induction mended: |dz| <= K |u| in a random direction each time, a policy
// that runs for the boundary, supports that move on: the state never leaves the union of the B_t.
TEST(Proposition1Test, NeverLeavesTheUnionOfSupports) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  core::Random random(7);
  const test::FunctionPolicy policy(2, 2,
                                    [](int t, std::span<const double> x, std::span<double> u) {
                                      u[0] = x[0] - t * kSpeed;
                                      u[1] = 3.0 * x[1] + 0.01;
                                    });
  for (const auto kind : {CertificateKind::kLipschitz, CertificateKind::kRadius}) {
    SCOPED_TRACE(Name(kind));
    constexpr double kGain = 2.0;
    GuidedOptions options;
    options.certificate = {kind, kGain, 0.0};
    GuidedPolicy guided(policy, model, options);
    std::vector<double> x(2), u(2), direction(2);
    int controls = 0;
    for (std::uint64_t seed = 0; controls < 20'000; ++seed) {
      guided.Reset(seed);
      x = {0.1 * random.Normal(), 0.1 * random.Normal()};
      while (guided.Next(x, u).mode != Mode::kHalt) {
        random.Direction(direction);
        const double move = kGain * test::Norm(u) * (1.0 - 1e-12);
        for (std::size_t i = 0; i < 2; ++i) x[i] += move * direction[i];
        double best = -1.0;
        for (int t = 0; t <= kSteps; ++t) best = std::max(best, support.LogDecision(t, x, {}));
        ASSERT_GE(best, -1e-12);  // rounding of a difference of logarithms
        ++controls;
      }
      ASSERT_NE(guided.halt_cause(), HaltCause::kOutsideSupport);
      ASSERT_NE(guided.halt_cause(), HaltCause::kViolated);
    }
  }
}

TEST(GuidedPolicyTest, TheSeedDecidesEverything) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.1);
  GuidedPolicy guided(policy, model);
  const auto controls = [&](std::uint64_t seed) {
    guided.Reset(seed);
    std::vector<double> all, u(2);
    for (int i = 0; i < 10; ++i) {
      (void)guided.Next(std::vector{0.0, 0.6}, u);
      all.insert(all.end(), u.begin(), u.end());
    }
    return all;
  };
  const auto first = controls(1);
  EXPECT_NE(controls(2), first);
  EXPECT_EQ(controls(1), first);
}

TEST(GuidedPolicyTest, HaltsAtEveryDoubt) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  std::vector<double> u(2);
  const auto nothing = test::ConstantPolicy(2, std::nan(""));
  GuidedPolicy guided(nothing, model);
  EXPECT_EQ(guided.Next(std::vector{0.0, 0.0}, u).cause, HaltCause::kNotReset);
  guided.Reset(1);
  EXPECT_EQ(guided.Next(std::vector{0.0, 0.0}, u).cause, HaltCause::kControlInvalid);
  guided.Reset(1);
  EXPECT_EQ(guided.Next(std::vector{0.0, std::nan("")}, u).cause, HaltCause::kStateInvalid);
  guided.Reset(1);
  EXPECT_EQ(guided.Next(std::vector{1e200, 0.0}, u).cause, HaltCause::kSupportInvalid);
}

TEST(GuidedPolicyTest, NextNeverAllocates) {
  const auto support = Moving();
  const GuidedModel model(Identity(), support, Rightwards());
  const auto policy = test::ConstantPolicy(2, 0.1);
  const auto fallback = test::ConstantPolicy(2, 0.05);
  for (const auto kind : {CertificateKind::kNone, CertificateKind::kLipschitz,
                          CertificateKind::kRadius, CertificateKind::kDirection}) {
    GuidedOptions options;
    options.certificate = {kind, 2.0, 2.0};
    if (kind == CertificateKind::kNone) options.drift_time = {.rest = 0.5, .travel = 1.0};
    GuidedPolicy guided(policy, model, options, &fallback);
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
}

TEST(GuidedPolicyTest, ErrorsNameTheCulprit) {
  const auto support = Moving();
  const auto message = [&](const GuidedOptions& options, int control_dim = 2) -> std::string {
    const GuidedModel model(Identity(), support, Rightwards());
    const test::FunctionPolicy policy(2, control_dim,
                                      [](int, std::span<const double>, std::span<double>) {});
    try {
      GuidedPolicy guided(policy, model, options);
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  EXPECT_THAT(message({}, 3), HasSubstr("3 control entries"));
  EXPECT_THAT(message({.horizon = 0}), HasSubstr("horizon"));
  EXPECT_THAT(message({.max_controls = 0}), HasSubstr("max_controls"));
  EXPECT_THAT(message({.control_limit = 0}), HasSubstr("control_limit"));
  EXPECT_THAT(message({.certificate = {CertificateKind::kRadius, 0.0, 0.0}}),
              HasSubstr("certified-radius needs a gain"));
  EXPECT_THAT(message({.certificate = {CertificateKind::kDirection, 0.0, 0.0}}),
              HasSubstr("certified-direction needs an eps"));
  EXPECT_THAT(message({.drift_time = {.rest = -1.0}}), HasSubstr("drift times"));
  EXPECT_THAT(
      message({.drift_time = {.travel = 1.0}, .certificate = {CertificateKind::kRadius, 1.0, 0.0}}),
      HasSubstr("certified-radius holds only where nothing else moves"));
  EXPECT_THROW(GuidedModel(Identity(), support, {}), std::invalid_argument);
  EXPECT_THROW(GuidedModel(Identity(), support, Rightwards(), {.accept_quantile = 0.9}),
               std::invalid_argument);
}

}  // namespace
}  // namespace dfr::control
