#include "dfr/control/published/gradient_recovery.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <stdexcept>
#include <vector>

#include "dfr/control/published/switching_controller.h"
#include "tests/control/analytic.h"
#include "tests/control/rightwards.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

// The gate requires g > 5 * 0.08 = 0.4. g is 0.5 in the centre and 0.06 at the start. The gate
// level of the model, a quantile over demonstrations, is above 0.4.
const std::vector<double> kLevelRate = {5.0};
const std::vector<double> kStart = {0.0, 0.38};

class GradientRecoveryTest : public test::RightwardsTest {};

TEST_F(GradientRecoveryTest, ReachesTheGateInAFewControls) {
  ASSERT_GT(support.FromLog(0, model.levels.gate(0)), 0.4);
  const auto policy = test::ConstantPolicy(2, 0.08);
  const auto controls = [&](SwitchingController controller) {
    test::TurnedPoint plant{.x = kStart};
    controller.Reset(1);
    for (int i = 0; i < 1000; ++i) {
      const Step step = controller.Next(plant.x, u);
      if (step.mode == Mode::kPolicy) return i;
      EXPECT_EQ(step.t, 0) << "a recovery consumes no time";
      if (step.mode == Mode::kHalt) break;
      plant.Apply(u);
    }
    ADD_FAILURE() << Name(controller.halt_cause());
    return 1000;
  };
  EXPECT_LE(controls(SwitchingController(policy, support, kLevelRate,
                                         std::make_unique<GradientRecovery>(model))),
            2);
  EXPECT_GT(controls(SwitchingController(policy, support, kLevelRate)), 50) << "DFR's probes";
}

// Each step ends at the gate level.
TEST_F(GradientRecoveryTest, AimsAtTheGateLevelOfTheTimeStep) {
  GradientRecovery recovery(model);
  for (const int t : {0, 6}) {
    recovery.Reset(1);
    const std::vector<double> x = {t * test::kSpeed, -0.38};
    ASSERT_EQ(recovery.Next({.t = t, .x = x, .g = 0.06, .lambda = 5.0}, u), Mode::kRecovery);
    const std::vector<double> there = {x[0] + u[0], x[1] + u[1]};
    // J is accurate to about the ridge divided by the weight of the demonstrations, 1e-3.
    EXPECT_NEAR(support.LogDecision(t, there, {}), model.levels.gate(t), 0.02);
  }
}

// The plant turns controls by 0.9 rad, a turn that demonstrations do not contain.
TEST_F(GradientRecoveryTest, LearnsFromItsOwnControls) {
  const auto policy = test::ConstantPolicy(2, 0.08);
  test::TurnedPoint plant{.angle = 0.9, .x = kStart};
  SwitchingController controller(policy, support, kLevelRate,
                                 std::make_unique<GradientRecovery>(model));
  controller.Reset(1);
  int controls = 0;
  Step step = controller.Next(plant.x, u);
  for (; step.mode == Mode::kRecovery && controls < 20; ++controls) {
    plant.Apply(u);
    step = controller.Next(plant.x, u);
  }
  EXPECT_EQ(step.mode, Mode::kPolicy) << Name(step.cause);
  EXPECT_LE(controls, 8);

  // The first control goes in the wrong direction, and the second control is closer to the right
  // one. A reset restores the wrong direction.
  plant.x = kStart;
  GradientRecovery recovery(model);
  std::vector<double> first(2), second(2);
  recovery.Reset(1);
  ASSERT_EQ(recovery.Next({.x = kStart, .g = 0.06, .lambda = 5.0}, first), Mode::kRecovery);
  plant.Apply(first);
  ASSERT_EQ(recovery.Next({.iteration = 1, .x = plant.x, .g = 0.06, .lambda = 5.0}, second),
            Mode::kRecovery);
  // Returns the angle between the motion and the direction to the centre.
  const auto off = [&](const std::vector<double>& control) {
    test::TurnedPoint moved = plant;
    moved.Apply(control);
    const double inwards =
        -(plant.x[0] * (moved.x[0] - plant.x[0]) + plant.x[1] * (moved.x[1] - plant.x[1]));
    return std::acos(inwards / test::Norm(plant.x) / test::Norm(control));
  };
  EXPECT_LT(off(second), 0.8);
  // At iteration 0 a recovery begins. The control that led to its state is unknown.
  recovery.Reset(1);
  ASSERT_EQ(recovery.Next({.x = plant.x, .g = 0.06, .lambda = 5.0}, second), Mode::kRecovery);
  EXPECT_NEAR(off(second), 0.9, 0.02);
}

// The first control ends outside the gate, at the limit, and has its predicted effect. The
// measurement then changes nothing.
TEST_F(GradientRecoveryTest, AConfirmedResponseIsUnchanged) {
  GradientRecovery recovery(model, 0.2);
  GradientRecovery fresh(model, 0.2);
  recovery.Reset(1);
  fresh.Reset(1);
  ASSERT_EQ(recovery.Next({.x = kStart, .g = 0.06, .lambda = 5.0}, u), Mode::kRecovery);
  test::TurnedPoint plant{.x = kStart};
  plant.Apply(u);
  std::vector<double> expected(2);
  ASSERT_EQ(recovery.Next({.iteration = 1, .x = plant.x, .g = 0.06, .lambda = 5.0}, u),
            Mode::kRecovery);
  ASSERT_EQ(fresh.Next({.x = plant.x, .g = 0.06, .lambda = 5.0}, expected), Mode::kRecovery);
  ASSERT_LT(std::abs(expected[1]), 0.19) << "within the limit";
  for (std::size_t k = 0; k < 2; ++k) EXPECT_NEAR(u[k], expected[k], 2e-3);
}

TEST_F(GradientRecoveryTest, HasNoDirectionIfControlsHaveNoEffect) {
  auto demonstrations = test::Rightwards();
  for (auto& d : demonstrations) d.states.setZero();
  const test::Task still(test::IdentityFeatures(), support, demonstrations);
  const auto policy = test::ConstantPolicy(2, 0.08);
  SwitchingController controller(policy, support, kLevelRate,
                                 std::make_unique<GradientRecovery>(still));
  controller.Reset(1);
  u = {1.0, 1.0};
  EXPECT_EQ(controller.Next(kStart, u).cause, HaltCause::kNoDirection);
  EXPECT_EQ(u, std::vector<double>({0.0, 0.0}));
}

TEST_F(GradientRecoveryTest, ControlsStayWithinTheLimit) {
  GradientRecovery recovery(model, 0.05);
  recovery.Reset(1);
  ASSERT_EQ(recovery.Next({.x = kStart, .g = 0.06, .lambda = 5.0}, u), Mode::kRecovery);
  // Allows for the rounding of the conversion to the control unit and back.
  EXPECT_NEAR(u[1], -0.05, 1e-15);
  EXPECT_LE(std::abs(u[0]), 0.05 * (1.0 + 1e-12));
}

TEST_F(GradientRecoveryTest, NeverAllocates) {
  GradientRecovery recovery(model);
  std::vector<double> x = kStart;
  const test::NoAlloc guard;
  recovery.Reset(1);
  for (int i = 0; i < 20; ++i) {
    x[0] = 0.01 * i;
    (void)recovery.Next({.iteration = i, .x = x, .g = 0.06, .lambda = 5.0}, u);
  }
}

TEST_F(GradientRecoveryTest, RefusesALimitThatIsNotPositive) {
  for (const double limit : {0.0, -1.0, std::nan("")}) {
    EXPECT_THROW(GradientRecovery(model, limit), std::invalid_argument) << limit;
  }
}

}  // namespace
}  // namespace dfr::control
