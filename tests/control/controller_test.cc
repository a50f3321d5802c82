#include "dfr/control/controller.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <string>
#include <vector>

namespace dfr::control {
namespace {

using testing::Each;

constexpr double kNotANumber = std::numeric_limits<double>::quiet_NaN();

// Returns the step and the control set by the test.
class Scripted final : public Controller {
 public:
  int state_dim() const noexcept override { return 2; }
  int control_dim() const noexcept override { return 3; }
  double control = 1.0;
  Step step{Mode::kPolicy};
  int calls = 0;
  std::uint64_t seed = 0;

 private:
  void DoReset(std::uint64_t s) noexcept override { seed = s; }
  Step DoNext(std::span<const double>, std::span<double> u) noexcept override {
    ++calls;
    for (double& entry : u) entry = control;
    return step;
  }
};

static_assert(noexcept(std::declval<Controller&>().Next({}, {})));
static_assert(noexcept(std::declval<Controller&>().Reset(0)));
static_assert(noexcept(std::declval<Controller&>().Stop(HaltCause::kStopRequested)));

class ControllerTest : public testing::Test {
 protected:
  void ExpectHalted(HaltCause cause) {
    std::fill(u.begin(), u.end(), 7.0);
    const Step step = controller.Next(x, u);
    EXPECT_EQ(step.mode, Mode::kHalt);
    EXPECT_STREQ(Name(step.cause), Name(cause));
    EXPECT_EQ(controller.halt_cause(), cause);
    EXPECT_THAT(u, Each(0.0));
  }

  Scripted controller;
  std::vector<double> x = {0.0, 0.0};
  std::vector<double> u = {7.0, 7.0, 7.0};
};

TEST_F(ControllerTest, HaltsUntilItIsReset) {
  ExpectHalted(HaltCause::kNotReset);
  EXPECT_EQ(controller.calls, 0);
  controller.Reset(5);
  EXPECT_EQ(controller.seed, 5u);
  EXPECT_EQ(controller.Next(x, u).mode, Mode::kPolicy);
  EXPECT_THAT(u, Each(1.0));
  EXPECT_EQ(controller.halt_cause(), HaltCause::kNone);
}

TEST_F(ControllerTest, HaltsOnANonFiniteStateWithoutCallingTheStrategy) {
  for (const double bad : {kNotANumber, std::numeric_limits<double>::infinity(),
                           -std::numeric_limits<double>::infinity()}) {
    controller.Reset(0);
    x[1] = bad;
    ExpectHalted(HaltCause::kStateInvalid);
    EXPECT_EQ(controller.calls, 0);
  }
}

TEST_F(ControllerTest, HaltsOnWrongSizes) {
  controller.Reset(0);
  x.push_back(0.0);
  ExpectHalted(HaltCause::kStateInvalid);
  controller.Reset(0);
  x.pop_back();
  u.pop_back();
  ExpectHalted(HaltCause::kControlInvalid);
}

TEST_F(ControllerTest, HaltsOnANonFiniteControl) {
  controller.Reset(0);
  controller.control = kNotANumber;
  ExpectHalted(HaltCause::kControlInvalid);
}

TEST_F(ControllerTest, StaysHaltedWithTheFirstCauseUntilReset) {
  controller.Reset(0);
  controller.step = Step{Mode::kHalt, HaltCause::kTimeUp, 9};
  ExpectHalted(HaltCause::kTimeUp);
  controller.step = Step{Mode::kPolicy};
  x[0] = kNotANumber;
  ExpectHalted(HaltCause::kTimeUp);
  x[0] = 0.0;
  controller.Stop(HaltCause::kPlantFault);
  ExpectHalted(HaltCause::kTimeUp);
  EXPECT_EQ(controller.Next(x, u).t, 9) << "the step that halted stays visible";
  EXPECT_EQ(controller.calls, 1);
  controller.Reset(0);
  EXPECT_EQ(controller.Next(x, u).mode, Mode::kPolicy);
}

TEST_F(ControllerTest, StopHaltsTheController) {
  controller.Reset(0);
  controller.Stop(HaltCause::kPlantFault);
  ExpectHalted(HaltCause::kPlantFault);
  EXPECT_EQ(controller.calls, 0);
}

// A prediction or certificate of an earlier step does not apply to the state at which the
// controller stopped.
TEST_F(ControllerTest, AStoppedStepNeitherPredictsNorCertifies) {
  for (const bool stops : {true, false}) {
    controller.Reset(0);
    controller.control = 1.0;
    controller.step = {.mode = Mode::kPolicy, .log_threshold = 0.2, .log_learned = 0.4};
    controller.step.certified = true;
    EXPECT_TRUE(controller.Next(x, u).certified);
    controller.control = kNotANumber;
    if (stops) controller.Stop(HaltCause::kStopRequested);
    for (int i = 0; i < 2; ++i) {
      const Step step = controller.Next(x, u);
      EXPECT_EQ(step.mode, Mode::kHalt);
      EXPECT_FALSE(step.certified);
      EXPECT_TRUE(std::isnan(step.log_learned));
      EXPECT_TRUE(std::isnan(step.log_threshold));
    }
  }
}

TEST(HaltCauseTest, NamesAreDistinct) {
  std::set<std::string> names;
  for (int i = 0; i < kNumHaltCauses; ++i) names.insert(Name(static_cast<HaltCause>(i)));
  EXPECT_EQ(names.size(), static_cast<std::size_t>(kNumHaltCauses));
  EXPECT_THAT(names, testing::Not(testing::Contains("unknown")));
}

}  // namespace
}  // namespace dfr::control
