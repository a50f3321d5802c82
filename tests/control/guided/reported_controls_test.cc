#include <gtest/gtest.h>

#include <tuple>
#include <vector>

#include "dfr/control/guided/guided_controller.h"
#include "tests/control/analytic.h"
#include "tests/control/rightwards.h"

namespace dfr::control {
namespace {

class ReportedControlsTest : public test::RightwardsTest {
 protected:
  // Expects that both controllers continue from `x` in the same way.
  void ExpectSame(GuidedController& a, GuidedController& b, const std::vector<double>& x) {
    const Step first = a.Next(x, u);
    const Step second = b.Next(x, u);
    EXPECT_EQ(first.mode, second.mode);
    EXPECT_EQ(first.t, second.t);
    EXPECT_EQ(first.iteration, second.iteration);
    EXPECT_EQ(first.log_learned, second.log_learned);
    EXPECT_TRUE(a.jacobian() == b.jacobian());
  }
  test::FunctionPolicy along_ = test::ConstantPolicy(2, test::kSpeed);
};

// B_0 and B_1 have the radius 0.416 and the centres (0, 0) and (0.1, 0). Within the exit level, the
// radius is 0.523.
TEST_F(ReportedControlsTest, ThePhaseFollowsTheReportedControl) {
  const std::vector<double> x = {-0.2, 0.2};
  for (const auto& [left, phase, waited] : {std::tuple(-0.18, 1, 0),    // ends inside B_1
                                            std::tuple(-0.3, 1, 0),     // within the exit level
                                            std::tuple(-0.4, 0, 1)}) {  // beyond it
    SCOPED_TRACE(left);
    GuidedController guided(along_, model, {.observer = false});
    ASSERT_NE(First(guided, x).mode, Mode::kHalt);
    const std::vector<double> there = {left, 0.3};
    guided.Applied(std::vector{there[0] - x[0], there[1] - x[1]});
    const Step step = guided.Next(there, u);
    EXPECT_EQ(step.t, phase);
    EXPECT_EQ(step.iteration, waited);
  }
}

TEST_F(ReportedControlsTest, ARetractedReportHasNoEffect) {
  GuidedController never(along_, model);
  GuidedController retracts(along_, model);
  ASSERT_EQ(First(never, {0.0, 0.0}).t, First(retracts, {0.0, 0.0}).t);
  retracts.Applied(std::vector{-0.5, 0.4});
  retracts.AppliedAsChosen();
  // The plant does not quite respond as predicted.
  ExpectSame(never, retracts, {0.08, 0.03});
}

TEST_F(ReportedControlsTest, AReportBeforeTheFirstControlHasNoEffect) {
  GuidedController fresh(along_, model);
  GuidedController used(along_, model);
  ASSERT_EQ(First(used, {0.0, 0.0}).t, 0);
  ASSERT_EQ(used.Next(std::vector{0.1, 0.0}, u).t, 1);
  for (const bool retracts : {false, true}) {
    used.Reset(1);
    fresh.Reset(1);
    used.Applied(std::vector{test::kSpeed, 0.0});
    if (retracts) used.AppliedAsChosen();
    ExpectSame(fresh, used, {0.0, 0.0});
  }
}

}  // namespace
}  // namespace dfr::control
