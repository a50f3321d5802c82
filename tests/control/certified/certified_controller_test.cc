#include "dfr/control/certified/certified_controller.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <stdexcept>
#include <vector>

#include "dfr/control/published/switching_controller.h"
#include "tests/control/analytic.h"
#include "tests/control/rightwards.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

using testing::HasSubstr;

using test::kSteps;
using test::Rightwards;

CertifiedOptions Certified(double direction_error) {
  return {.certificate = {.direction_error = direction_error}};
}

class CertifiedControllerTest : public test::RightwardsTest {};
using Proposition1Test = CertifiedControllerTest;

// The controller checks |dz - J u| <= eps |u| and stops a plant that violates this bound after the
// first such control.
TEST_F(CertifiedControllerTest, HaltsAtTheFirstViolation) {
  const auto policy = test::ConstantPolicy(2, 0.05);
  CertifiedController certified(policy, model, Certified(0.1));
  certified.Reset(1);
  std::vector<double> x = {0.0, 0.0};
  for (int i = 0; i < 2; ++i) {
    const Step step = certified.Next(x, u);
    ASSERT_NE(step.mode, Mode::kHalt);
    EXPECT_TRUE(step.certified);
    EXPECT_TRUE(std::isnan(step.observed_error));
    // The first control has the predicted effect. The second control has twice its predicted
    // effect.
    for (std::size_t k = 0; k < 2; ++k) x[k] += (i == 0 ? 1.0 : 2.0) * u[k];
  }
  const double predicted = (certified.jacobian() * core::AsVector(std::span<const double>(u)) /
                            model.response.control_unit())[0];
  const double speed = u[0];
  const Step step = certified.Next(x, u);
  EXPECT_EQ(step.cause, HaltCause::kViolated);
  EXPECT_NEAR(step.observed_error, std::abs(2.0 * speed - predicted) / speed, 1e-3);
  EXPECT_GT(step.observed_error, 0.1);
}

// Fractions of learned controls consume fractions of time steps. Only a fraction of the control
// passes each time, and the horizon of one step ends once the fractions sum to 1.
TEST_F(CertifiedControllerTest, AShrunkLearnedControlConsumesItsShareOfATimeStep) {
  const test::Task middle(test::IdentityFeatures(), support, Rightwards(), {.gate_quantile = 0.5});
  const auto policy = test::ConstantPolicy(2, 0.08);
  CertifiedOptions options = Certified(17.0);
  options.horizon = 1;
  CertifiedController certified(policy, middle, options);
  certified.Reset(1);
  double time = 0.0;
  int controls = 0;
  for (;; ++controls) {
    const Step step = certified.Next(std::vector{0.05, 0.0}, u);
    if (step.mode == Mode::kHalt) break;
    ASSERT_EQ(step.mode, Mode::kPolicy);
    ASSERT_FALSE(step.filtered && u[1] != 0.0);
    ASSERT_LT(time, 1.0) << "the time was used up before";
    time += u[0] / 0.08;
  }
  EXPECT_EQ(certified.halt_cause(), HaltCause::kTimeUp);
  EXPECT_GE(time, 1.0);
  EXPECT_GE(controls, 2);
}

// At x = 0.05 the state is equally deep in B_0 and B_1. The phase becomes 1 if at least half of the
// learned control passed.
TEST_F(CertifiedControllerTest, HalfALearnedControlAdvancesThePhase) {
  const auto policy = test::ConstantPolicy(2, 0.08);
  const std::vector<double> x = {0.05, 0.0};
  int advanced = 0;
  for (int i = 0; i < 34; ++i) {
    const double error = 5.0 + 0.3 * i;
    SCOPED_TRACE(error);
    CertifiedController certified(policy, model, Certified(error));
    ASSERT_EQ(First(certified, x).mode, Mode::kPolicy);
    const double share = u[0] / 0.08;
    EXPECT_EQ(certified.Next(x, u).t, share >= 0.5 ? 1 : 0) << share;
    advanced += share >= 0.5 ? 1 : 0;
  }
  EXPECT_GT(advanced, 3);
  EXPECT_LT(advanced, 30);
}

// g_t(x) = exp(-(x - c_t)^2) - 0.5 with c_0 = 0, c_1 = 1, K = 1: at x = -0.6 the published gate
// g_0(x) > L K |u| lets u = 0.001 pass in any direction, and the state is then outside B_1, which
// the proof by induction excludes. The certified controller holds the phase instead.
TEST_F(Proposition1Test, ThePublishedGateBreaksItsInvariantAndTheCertifiedControllerKeepsIt) {
  const test::GaussianSupport two({{0.0}}, 1.0, 0.5, {1.0}, 2);
  const auto policy = test::ConstantPolicy(1, 0.001);
  std::vector<double> x = {-0.6};
  u.resize(1);
  SwitchingController published(policy, two, two.lipschitz_bound());
  ASSERT_EQ(First(published, x).mode, Mode::kPolicy);
  x[0] += u[0];
  EXPECT_NEAR(two.Decision(1, x), -0.422, 1e-3);
  EXPECT_EQ(published.Next(x, u).cause, HaltCause::kOutsideSupport);

  std::vector<core::Trajectory> demonstrations(2);
  for (std::size_t d = 0; d < 2; ++d) {
    demonstrations[d].states.resize(2, 1);
    demonstrations[d].states << 0.0 + 0.1 * static_cast<double>(d), 1.0;
    demonstrations[d].controls.resize(1, 1);
    demonstrations[d].controls << 1.0;
  }
  const test::Task line(test::IdentityFeatures(1), two, demonstrations);
  CertifiedController held(policy, line, Certified(1.0));
  held.Reset(1);
  x = {-0.6};
  for (int i = 0; i < 50; ++i) {
    const Step step = held.Next(x, u);
    if (step.mode == Mode::kHalt) {
      ASSERT_EQ(step.cause, HaltCause::kNoProgress);
      break;
    }
    ASSERT_GE(two.Decision(step.t, x), 0.0) << "the support of the phase contains the state";
    x[0] += u[0];
    ASSERT_GE(std::max(two.Decision(0, x), two.Decision(1, x)), 0.0);
  }
}

// Prop. IV.3 with a corrected induction: the state never leaves the union of the B_t. Every effect
// has an error of eps |u| in a random direction. The policy steers towards the boundary, and the
// supports move.
TEST_F(Proposition1Test, NeverLeavesTheUnionOfSupports) {
  core::Random random(7);
  const test::FunctionPolicy policy(
      2, 2, [](int t, std::span<const double> state, std::span<double> learned) {
        learned[0] = state[0] - t * test::kSpeed;
        learned[1] = 3.0 * state[1] + 0.01;
      });
  constexpr double kError = 0.7;
  CertifiedController certified(policy, model, Certified(kError));
  std::vector<double> x(2), direction(2);
  int controls = 0;
  for (std::uint64_t seed = 0; controls < 5000; ++seed) {
    certified.Reset(seed);
    x = {0.1 * random.Normal(), 0.1 * random.Normal()};
    while (certified.Next(x, u).mode != Mode::kHalt) {
      random.Direction(direction);
      const Eigen::VectorXd effect = certified.jacobian() *
                                     core::AsVector(std::span<const double>(u)) /
                                     model.response.control_unit();
      const double move = kError * test::Norm(u) * (1.0 - 1e-12);
      for (std::size_t i = 0; i < 2; ++i) {
        x[i] += effect[static_cast<Eigen::Index>(i)] + move * direction[i];
      }
      double best = -1.0;
      for (int t = 0; t <= kSteps; ++t) best = std::max(best, support.LogDecision(t, x, {}));
      ASSERT_GE(best, -1e-12);  // rounding of a difference of logarithms
      ++controls;
    }
    ASSERT_NE(certified.halt_cause(), HaltCause::kOutsideSupport);
    ASSERT_NE(certified.halt_cause(), HaltCause::kViolated);
  }
}

// Episodes are deterministic and independent of earlier ones. Steps allocate no memory.
TEST_F(CertifiedControllerTest, TheSameStatesGiveTheSameControls) {
  const auto policy = test::ConstantPolicy(2, 0.1);
  CertifiedController certified(policy, model, Certified(2.0));
  std::vector<double> all(60), first(60), x(2);
  const auto episode = [&](std::uint64_t seed) {
    const test::NoAlloc guard;
    certified.Reset(seed);
    std::ranges::copy(std::array{0.0, 0.3}, x.begin());
    for (std::size_t i = 0; i < all.size(); i += 2) {
      const std::span<double> next(&all[i], 2);
      (void)certified.Next(x, next);
      for (std::size_t k = 0; k < 2; ++k) x[k] += next[k];
    }
  };
  episode(1);
  first = all;
  episode(1);
  EXPECT_EQ(all, first);
  episode(2);
  EXPECT_EQ(all, first);
}

// Demonstrations move at one speed or stand still. The first entry of a control keeps these two
// values, even if the second entry is raised or probed.
TEST_F(CertifiedControllerTest, AnEntryWithFewValuesKeepsThem) {
  const test::Task task{test::IdentityFeatures(), support, test::RightwardsOrStill()};
  const test::FunctionPolicy policy(
      2, 2, [](int t, std::span<const double>, std::span<double> learned) {
        std::ranges::copy(std::array{t % 2 == 0 ? test::kSpeed : 0.0, 0.2}, learned.begin());
      });
  int changed = 0;
  for (const double error : {0.1, 0.5, 2.0}) {
    CertifiedController certified(policy, task, Certified(error));
    certified.Reset(1);
    std::vector<double> x = {0.0, 0.2};
    for (int i = 0; i < 15; ++i) {
      const Step step = certified.Next(x, u);
      if (step.mode == Mode::kHalt) break;
      const double nearest = u[0] > 0.5 * test::kSpeed ? test::kSpeed : 0.0;
      EXPECT_NEAR(u[0], nearest, 1e-12) << error << ", control " << i;
      changed += step.filtered || step.mode != Mode::kPolicy ? 1 : 0;
      for (std::size_t k = 0; k < 2; ++k) x[k] += u[k];
    }
  }
  EXPECT_GT(changed, 5);
}

// A raise goes beyond correction_limit only as far as the learned control does.
TEST_F(CertifiedControllerTest, ACorrectionStaysWithinItsLimit) {
  const test::FunctionPolicy policy(2, 2,
                                    [](int, std::span<const double>, std::span<double> learned) {
                                      std::ranges::copy(std::array{0.12, 0.0}, learned.begin());
                                    });
  const std::vector<double> x = {0.0, 0.3};
  CertifiedController free(policy, model, Certified(0.1));
  ASSERT_EQ(First(free, x).mode, Mode::kPolicy);
  ASSERT_LT(u[1], -0.05);
  CertifiedOptions options = Certified(0.1);
  options.correction_limit = {0.05};
  CertifiedController bounded(policy, model, options);
  ASSERT_NE(First(bounded, x).mode, Mode::kHalt);
  EXPECT_GE(u[1], -0.05 - 1e-12);
  EXPECT_LT(u[1], -0.04);
  EXPECT_LE(u[0], 0.12 + 1e-12);
}

// Each control consumes its share of the time, and the state does not change. Only recoveries and
// probes count against the patience.
TEST_F(CertifiedControllerTest, LearnedControlsInOnePhaseEndWithTheTime) {
  const auto policy = test::ConstantPolicy(2, 0.08);
  CertifiedOptions options = Certified(17.0);
  options.horizon = 8;
  CertifiedController certified(policy, model, options);
  certified.Reset(1);
  int controls = 0;
  while (certified.Next(std::vector{0.0, 0.0}, u).mode == Mode::kPolicy) ++controls;
  EXPECT_EQ(certified.halt_cause(), HaltCause::kTimeUp);
  EXPECT_GT(controls, options.patience);
}

// Supports at rest contain the state. The policy pauses for longer than certified::kMaxStalls.
TEST_F(CertifiedControllerTest, APauseOfThePolicyIsNoStall) {
  const test::GaussianSupport disk({{0.0, 0.0}}, 4.0, 0.5, {}, kSteps + 1);
  const test::Task task{test::IdentityFeatures(), disk, Rightwards()};
  const auto policy = test::ConstantPolicy(2, 0.0);
  CertifiedController certified(policy, task, Certified(0.5));
  certified.Reset(1);
  for (int i = 0; i < kSteps - 1; ++i) {
    const Step step = certified.Next(std::vector{0.0, 0.0}, u);
    ASSERT_EQ(step.mode, Mode::kPolicy) << Name(step.cause) << " at control " << i;
    EXPECT_EQ(step.t, i);
    EXPECT_FALSE(step.filtered);
    EXPECT_EQ(u, std::vector({0.0, 0.0}));
  }
}

// A state in the middle of B_0 and B_1, and a small control.
TEST_F(CertifiedControllerTest, AControlThatPassesIsUnchanged) {
  const auto policy = test::ConstantPolicy(2, 0.08);
  CertifiedController certified(policy, model, Certified(0.1));
  const Step step = First(certified, {0.05, 0.0});
  EXPECT_EQ(step.mode, Mode::kPolicy);
  EXPECT_FALSE(step.filtered);
  EXPECT_TRUE(std::isnan(step.change));
  EXPECT_EQ(u, (std::vector{0.08, 0.0}));
}

// No control within the limit leads back into B_1. The exit level is 2 * 0.2, and
// l_1 = log 2 - 4 |x - (0.1, 0)|^2.
TEST_F(CertifiedControllerTest, AChangedControlBeyondTheExitLevelIsARecovery) {
  const auto policy = test::ConstantPolicy(2, 0.002);
  CertifiedOptions options = Certified(0.1);
  options.certificate.level = 1.0;
  options.control_limit = {0.002};
  for (const double y : {0.5, 0.55}) {
    CertifiedController certified(policy, model, options);
    const Step step = First(certified, {0.1, y});
    const bool beyond = std::log(2.0) - 4.0 * y * y < -0.4;
    EXPECT_EQ(beyond, y == 0.55);
    EXPECT_EQ(step.mode, beyond ? Mode::kRecovery : Mode::kPolicy);
    EXPECT_EQ(step.filtered, !beyond);
    const double change = std::hypot(u[0] - 0.002, u[1]) / model.response.control_unit();
    EXPECT_NEAR(step.change, change, 1e-12);
    EXPECT_GT(change, 0.0);
  }
}

// The excess over a limit may vanish in the rounding of the control's norm.
TEST_F(CertifiedControllerTest, ATinyExcessOverALimitIsRemoved) {
  const test::FunctionPolicy policy(2, 2,
                                    [](int, std::span<const double>, std::span<double> learned) {
                                      std::ranges::copy(std::array{0.05, 1e-10}, learned.begin());
                                    });
  CertifiedOptions options = Certified(0.1);
  options.control_limit = {1.0, 0.0};
  CertifiedController certified(policy, model, options);
  const Step step = First(certified, {0.0, 0.0});
  EXPECT_EQ(step.mode, Mode::kPolicy);
  EXPECT_TRUE(step.filtered);
  EXPECT_EQ(u[1], 0.0);
}

TEST_F(CertifiedControllerTest, HaltsOutsideTheSupportAndOnNonFiniteValues) {
  const auto nothing = test::ConstantPolicy(2, std::nan(""));
  CertifiedController certified(nothing, model, Certified(1.0));
  EXPECT_EQ(First(certified, {0.0, 0.0}).cause, HaltCause::kControlInvalid);
  EXPECT_EQ(First(certified, {1e200, 0.0}).cause, HaltCause::kSupportInvalid);
  EXPECT_EQ(First(certified, {0.0, 2.0}).cause, HaltCause::kOutsideSupport);
}

TEST_F(CertifiedControllerTest, ErrorsNameTheCulprit) {
  const auto message = [&](CertifiedOptions options, int control_dim = 2) {
    if (options.certificate.direction_error == 0.0) options.certificate.direction_error = 1.0;
    const test::FunctionPolicy policy(2, control_dim, nullptr);
    return test::MessageOf<std::invalid_argument>(
        [&] { const CertifiedController certified(policy, model, options); });
  };
  EXPECT_THAT(message({}, 3), HasSubstr("3 control entries"));
  EXPECT_THAT(message({.certificate = {.direction_error = -1.0}}), HasSubstr("needs an eps"));
  EXPECT_THAT(message({.horizon = 0}), HasSubstr("horizon"));
  EXPECT_THAT(message({.first_step = -1}), HasSubstr("first_step"));
  EXPECT_THAT(message({.max_controls = 0}), HasSubstr("max_controls"));
  EXPECT_THAT(message({.control_limit = {-1.0}}), HasSubstr("control_limit"));
  EXPECT_THAT(message({.correction_limit = {-1.0}}), HasSubstr("correction_limit"));
  EXPECT_THAT(message({.iterations = -1}), HasSubstr("iterations"));
  EXPECT_THAT(message({.patience = 0}), HasSubstr("patience"));
  EXPECT_THAT(message({.probe_size = -0.1}), HasSubstr("probe_size"));
}

}  // namespace
}  // namespace dfr::control
