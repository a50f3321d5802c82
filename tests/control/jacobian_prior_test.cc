#include "dfr/control/jacobian_prior.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/matrix.h"

namespace dfr::control {
namespace {

TEST(JacobianPriorTest, ErrorsNameTheCulprit) {
  const std::vector<core::Matrix> features(3, core::Matrix::Ones(6, 3));
  std::vector<core::Matrix> controls(3, core::Matrix::Ones(5, 2));
  const auto message = [&](const JacobianOptions& options) -> std::string {
    try {
      const JacobianPrior prior(features, controls, options);
    } catch (const std::invalid_argument& e) {
      return e.what();
    }
    return "nothing thrown";
  };
  EXPECT_EQ(message({}), "nothing thrown");
  EXPECT_THAT(message({.ridge = 0.0}), testing::HasSubstr("ridge"));
  EXPECT_THAT(message({.motion_ridge = 0.0}), testing::HasSubstr("motion_ridge"));
  EXPECT_THAT(message({.slope_ridge = -1.0}), testing::HasSubstr("slope_ridge"));
  EXPECT_THAT(message({.forgetting = 1.0}), testing::HasSubstr("forgetting"));
  EXPECT_THAT(message({.max_per_step = 0}), testing::HasSubstr("max_per_step"));
  controls[1] = core::Matrix::Ones(4, 2);
  EXPECT_THAT(message({}), testing::HasSubstr("demonstration 1"));
}

}  // namespace
}  // namespace dfr::control
