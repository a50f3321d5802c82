#include "dfr/control/published/lambda.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>
#include <vector>

#include "tests/control/analytic.h"
#include "tests/support/message_of.h"

namespace dfr::control {
namespace {

using core::Trajectory;
using testing::ElementsAre;
using testing::HasSubstr;

// Returns a trajectory with one state entry and one control entry.
Trajectory Make(const std::vector<double>& states, const std::vector<double>& controls) {
  Trajectory trajectory;
  trajectory.states = Eigen::Map<const core::Matrix>(states.data(), std::ssize(states), 1);
  trajectory.controls = Eigen::Map<const core::Matrix>(controls.data(), std::ssize(controls), 1);
  return trajectory;
}

// g_t(x) = (t + 1) x.
const test::FunctionSupport kLinear(1, [](int t, std::span<const double> x) {
  return (t + 1) * x[0];
});

TEST(EstimateLambdaTest, IsTheLargestChangeOfTheSameGPerUnitOfControl) {
  // Step 0: |g_0(1) - g_0(0)| / 2 = 0.5 and |g_0(3) - g_0(0)| / 4 = 0.75.
  // Step 1: |g_1(0) - g_1(1)| / 1 = 2 and |g_1(4) - g_1(3)| / 2 = 1.
  const std::vector<Trajectory> demonstrations = {Make({0, 1, 0}, {2, -1}),
                                                  Make({0, 3, 4}, {-4, 2})};
  EXPECT_THAT(EstimateLambda(kLinear, demonstrations), ElementsAre(0.75, 2.0));
}

TEST(EstimateLambdaTest, LeavesOutZeroControlsAndTakesTheNearestKnownStep) {
  // Steps 0 and 3 have only zero controls. Step 4 has a control that changes nothing.
  const std::vector<Trajectory> demonstrations = {
      Make({0, 9, 10, 11, 50, 50}, {0, 1, 2, 0, 1}),
      Make({0, 5}, {0}),
  };
  EXPECT_THAT(EstimateLambda(kLinear, demonstrations), ElementsAre(2.0, 2.0, 1.5, 1.5, 1.5));
}

TEST(EstimateLambdaTest, ErrorsNameTheDemonstration) {
  const auto message = [](const std::vector<Trajectory>& demonstrations) {
    return test::MessageOf<std::invalid_argument>(
        [&] { (void)EstimateLambda(kLinear, demonstrations); });
  };
  EXPECT_THAT(message({}), HasSubstr("0 demonstrations"));
  EXPECT_THAT(message({Make({0, 1}, {0})}), HasSubstr("1 demonstrations"));
  const Trajectory good = Make({0, 1}, {1});
  EXPECT_THAT(message({good, Make({0, 1}, {1, 1})}), HasSubstr("demonstration 1: 2 controls"));
  EXPECT_THAT(message({good, Make({0, std::numeric_limits<double>::quiet_NaN()}, {1})}),
              HasSubstr("demonstration 1 has a non-finite entry"));
  Trajectory wide = good;
  wide.states = core::Matrix::Zero(2, 3);
  EXPECT_THAT(message({wide}), HasSubstr("have 3 entries, but the support takes 1"));
}

}  // namespace
}  // namespace dfr::control
