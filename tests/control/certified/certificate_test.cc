#include "dfr/control/certified/certificate.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "dfr/core/random.h"
#include "tests/control/analytic.h"
#include "tests/support/no_alloc.h"

namespace dfr::control {
namespace {

test::GaussianSupport TwoBumps() { return {{{0.0, 0.0}, {1.5, 0.5}}, 0.8, 0.2}; }

// The definition of the ball: every state in it has l >= 0.
TEST(SafeBallTest, LiesInsideTheSupportAndNeverAllocates) {
  const auto support = TwoBumps();
  core::Random random(1);
  std::vector<double> z(2), shift(2), direction(2), there(2);
  int inside = 0;
  const test::NoAlloc guard;
  for (int i = 0; i < 5000; ++i) {
    for (double& entry : z) entry = random.Uniform(-1.5, 3.0);
    const SafeBall ball = ComputeSafeBall(support, 0, z, shift);
    const double l = support.LogDecision(0, z, {});
    ASSERT_EQ(ball.radius >= 0.0, l >= 0.0);
    if (l < 0.0) continue;
    ++inside;
    random.Direction(direction);
    for (std::size_t k = 0; k < 2; ++k) there[k] = z[k] + shift[k] + ball.radius * direction[k];
    // Allows for the rounding of l, a difference of logarithms of order one.
    ASSERT_GE(support.LogDecision(0, there, {}), -1e-14);
    ASSERT_GE(ball.radius - ball.shift_norm, 0.0);
  }
  EXPECT_GT(inside, 750);
}

// For one Gaussian, {l >= 0} is a ball, and the certificate finds the whole ball from every state.
TEST(SafeBallTest, IsExactForOneGaussian) {
  const test::GaussianSupport support({{0.3, -0.2}}, 2.0, 0.5);
  const double radius = std::sqrt(std::log(2.0) / 2.0);
  std::vector<double> shift(2);
  for (const double x : {0.0, 0.3, 0.6}) {
    const SafeBall ball = ComputeSafeBall(support, 0, std::vector{x, -0.2}, shift);
    EXPECT_NEAR(ball.radius, radius, 1e-14);
    EXPECT_NEAR(x + shift[0], 0.3, 1e-14);
    EXPECT_NEAR(ball.radius - ball.shift_norm, radius - std::abs(x - 0.3), 1e-14);
  }
}

// Checks the definition, |s a - shift| + s e <= radius, at the result and above it.
TEST(LargestShareTest, IsTheLargestThatPassesAndNeverAllocates) {
  core::Random random(3);
  const auto passes = [](const SafeBall& ball, const std::vector<double>& shift,
                         const std::vector<double>& a, double e, double s) {
    double square = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i) {
      square += (s * a[i] - shift[i]) * (s * a[i] - shift[i]);
    }
    return std::sqrt(square) + s * e <= ball.radius;
  };
  std::vector<double> shift(3), a(3);
  int partial = 0;
  const test::NoAlloc guard;
  for (int i = 0; i < 5000; ++i) {
    SafeBall ball;
    double square = 0.0;
    for (std::size_t k = 0; k < 3; ++k) {
      shift[k] = random.Normal();
      a[k] = std::pow(10.0, random.Uniform(-3.0, 1.0)) * random.Normal();
      square += shift[k] * shift[k];
    }
    ball.shift_norm = std::sqrt(square);
    ball.radius = ball.shift_norm + random.Uniform(0.0, 1.0);
    const double e = random.Below(4) == 0 ? 0.0 : random.Uniform(0.0, 3.0);
    const double share = LargestShare(ball, shift, a, e);
    ASSERT_GE(share, 0.0);
    ASSERT_LE(share, 1.0);
    if (share == 0.0) continue;
    ASSERT_TRUE(passes(ball, shift, a, e, share)) << i;
    if (share == 1.0) continue;
    ++partial;
    // The result is deliberately a billionth below the largest share.
    ASSERT_FALSE(passes(ball, shift, a, e, share * (1.0 + 1e-6))) << i;
  }
  EXPECT_GT(partial, 1250);
}

TEST(LargestShareTest, IsZeroOutsideAndOneTowardsTheCentre) {
  const std::vector<double> shift = {0.5, 0.0};
  EXPECT_EQ(LargestShare({-1.0, 0.5}, shift, std::vector{0.1, 0.0}, 0.0), 0.0);
  // The control leads to the centre of the ball and stops there.
  EXPECT_EQ(LargestShare({0.6, 0.5}, shift, std::vector{0.5, 0.0}, 0.0), 1.0);
  // The control leads from the boundary through the centre to the opposite boundary.
  EXPECT_NEAR(LargestShare({0.5, 0.5}, shift, std::vector{1.2, 0.0}, 0.0), 1.0 / 1.2, 2e-9);
  // The control leads outwards from the boundary.
  EXPECT_EQ(LargestShare({0.5, 0.5}, shift, std::vector{-1.0, 0.0}, 0.0), 0.0);
  // The control leads along the boundary.
  EXPECT_EQ(LargestShare({0.5, 0.5}, shift, std::vector{0.0, 1.0}, 0.0), 0.0);
}

}  // namespace
}  // namespace dfr::control
