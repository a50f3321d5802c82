#include "dfr/sim/line_tracking/arm_error.h"

#include <gtest/gtest.h>

#include <stdexcept>

#include "dfr/core/random.h"
#include "tests/support/all_close.h"

namespace dfr::sim {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

// Returns the mean error of the tip over joint values in reach of the gauze. ArmError scales its
// errors with another sample of joint values.
template <typename Known>
double MeanError(const ArmError& error, const Known& known) {
  core::Random random(7);
  double sum = 0.0;
  for (int i = 0; i < 2000; ++i) {
    PsmJoints q;
    q << random.Uniform(-0.25, 0.25), random.Uniform(-0.2, 0.2), random.Uniform(0.105, 0.135),
        random.Uniform(-0.25, 0.25), random.Uniform(-0.25, 0.25), random.Uniform(-0.25, 0.25);
    sum += (Psm::Tip(error.Truth(q, random.Uniform(0.0, 6.28))) - Psm::Tip(known(q))).norm();
  }
  return sum / 2000;
}

TEST(ArmErrorTest, IsAsLargeAsReportedForUncalibratedArms) {
  for (std::uint64_t seed : {1, 2, 3, 4, 5}) {
    const ArmError error({.seed = seed});
    const double mean = MeanError(error, [](const PsmJoints& q) { return q; });
    EXPECT_NEAR(mean, 4.5e-3, 0.2e-3) << seed;  // another sample of 2000, with a spread of a few mm
    const double residual =
        MeanError(error, [&](const PsmJoints& q) { return error.systematic().Apply(q); });
    EXPECT_NEAR(residual, 0.5e-3, 0.05e-3) << seed;
  }
}

TEST(ArmErrorTest, SameSeedIsTheSameArm) {
  PsmJoints q;
  q << 0.1, -0.1, 0.12, 0.1, 0.0, 0.2;
  const ArmError a({.seed = 3});
  EXPECT_EQ(a.Truth(q, 1.0), ArmError({.seed = 3}).Truth(q, 1.0));
  EXPECT_NE(a.Truth(q, 1.0), ArmError({.seed = 4}).Truth(q, 1.0));
  EXPECT_NE(a.Truth(q, 1.0), a.Truth(q, 2.0));
  EXPECT_EQ(ArmError().Truth(q, 1.0), q);
}

TEST(ArmErrorTest, BadOptionsThrow) {
  EXPECT_THROW(ArmError({.mean_error_m = -1.0}), std::invalid_argument);
  EXPECT_THROW(ArmError({.mean_error_m = 1e-3, .mean_residual_m = 2e-3}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::sim
