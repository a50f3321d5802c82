#include "dfr/core/features/feature_decision.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "dfr/core/features/state_map.h"
#include "tests/support/no_alloc.h"

namespace dfr::core {
namespace {

FeatureSelection Named(const char* name) {
  StateLayout layout;
  layout.Add("arm", 3);
  layout.Add("object", 2);
  layout.Add("tip", 3);
  return {layout, name};
}

// g = l = t + z_0 + 10 z_1. The values show the position of each entry.
class Planar final : public LogDecisionFunction {
 public:
  int state_dim() const noexcept override { return 2; }
  int num_steps() const noexcept override { return 5; }
  double Decision(int t, std::span<const double> z) const noexcept override {
    const double value = t + z[0] + 10.0 * z[1];
    return std::isfinite(value) ? value : -std::numeric_limits<double>::infinity();
  }
  double Gradient(int t, std::span<const double> z, std::span<double> g) const noexcept override {
    return LogDecision(t, z, g);
  }
  double LogDecision(int t, std::span<const double> z,
                     std::span<double> g) const noexcept override {
    const double value = Decision(t, z);
    if (!g.empty()) {
      g[0] = std::isfinite(value) ? 1.0 : 0.0;
      g[1] = 10.0 * g[0];
    }
    return value;
  }
  double FromLog(int t, double l) const noexcept override { return t + l; }
  double curvature_bound(int) const noexcept override { return 2.0; }
};

FeatureTransform Object() { return FeatureTransform::Identity(Named("object")); }

const std::vector<double> kState = {9, 9, 9, 1, 2, 9, 9, 9};

TEST(FeatureDecisionTest, ASelectionUsesTheInnerFunction) {
  const Planar inner;
  const FeatureDecision decision(Object(), inner);
  std::vector<double> gradient(8, -1.0);
  const test::NoAlloc guard;
  EXPECT_EQ(decision.Decision(3, kState), 3 + 1 + 20);
  EXPECT_EQ(decision.Gradient(3, kState, gradient), 24);
  EXPECT_EQ(gradient[3], 1.0);
  EXPECT_EQ(gradient[4], 10.0);
  EXPECT_EQ(gradient[0], 0.0);
  EXPECT_EQ(gradient[7], 0.0);
  EXPECT_EQ(decision.LogDecision(3, kState, {}), 24);
  EXPECT_EQ(decision.FromLog(3, 2.0), 5.0);
  EXPECT_EQ(decision.num_steps(), 5);
  EXPECT_EQ(decision.curvature_bound(0), 2.0);
}

TEST(FeatureDecisionTest, FollowsTheChainRule) {
  const Planar inner;
  Matrix scale(2, 2);
  scale << 2.0, 1.0, 0.0, 3.0;
  const FeatureDecision decision({Named("object"), Eigen::Vector2d(1.0, 1.0), scale}, inner);
  std::vector<double> gradient(8, -1.0);
  const test::NoAlloc guard;
  // z = (2 0 + 1 1, 3 1)
  EXPECT_EQ(decision.LogDecision(3, kState, gradient), 3 + 1 + 30);
  EXPECT_EQ(gradient[3], 2.0);
  EXPECT_EQ(gradient[4], 31.0);
  EXPECT_EQ(gradient[5], 0.0);
  // The larger singular value: the roots of s^2 - 14 s + 36 are the squares of both values.
  const double norm = std::sqrt(7.0 + std::sqrt(13.0));
  EXPECT_NEAR(decision.curvature_bound(0), 2.0 * norm * norm, 1e-12);
}

// The derivatives with respect to the entries of -q and of q differ in sign only.
TEST(FeatureDecisionTest, FollowsTheMapOfTheSelection) {
  const Planar inner;
  StateLayout layout;
  layout.Add("turn", 4);
  const StateMap map({{.first = 0, .reference = {1.0, 0.0, 0.0, 0.0}}}, {});
  const FeatureDecision decision(
      FeatureTransform::Identity(FeatureSelection(layout, "turn[0:2]").Mapped(map)), inner);
  for (const double sign : {1.0, -1.0}) {
    const std::vector<double> x = {sign * 0.8, sign * 0.6, 0.0, 0.0};
    std::vector<double> gradient(4, 7.0);
    EXPECT_EQ(decision.Decision(3, x), 3 + 0.8 + 10.0 * 0.6);
    EXPECT_EQ(decision.LogDecision(3, x, gradient), decision.Decision(3, x));
    EXPECT_EQ(gradient, (std::vector{sign, sign * 10.0, 0.0, 0.0}));
    gradient.assign(4, 7.0);
    EXPECT_EQ(decision.Gradient(3, x, gradient), decision.Decision(3, x));
    EXPECT_EQ(gradient, (std::vector{sign, sign * 10.0, 0.0, 0.0}));
  }
}

TEST(FeatureDecisionTest, TheGradientAtANonFiniteStateIsZero) {
  const Planar inner;
  StateLayout layout;
  layout.Add("turn", 1);
  const StateMap map({}, {}, {{.entry = 0, .period = 6.0}});
  const FeatureDecision decision(
      FeatureTransform::Identity(FeatureSelection(layout, "turn").Mapped(map)), inner);
  for (const double wrong : {HUGE_VAL, std::nan("")}) {
    const std::vector<double> x = {wrong};
    std::vector<double> gradient = {7.0};
    EXPECT_EQ(decision.LogDecision(0, x, gradient), -HUGE_VAL);
    EXPECT_EQ(gradient[0], 0.0);
    gradient = {7.0};
    EXPECT_EQ(decision.Gradient(0, x, gradient), -HUGE_VAL);
    EXPECT_EQ(gradient[0], 0.0);
  }
}

TEST(FeatureDecisionTest, EntriesThatNoFeatureReadsHaveNoEffect) {
  const Planar inner;
  const FeatureDecision decision(Object(), inner);
  std::vector<double> x = kState;
  x[0] = std::nan("");
  x[7] = HUGE_VAL;
  std::vector<double> gradient(8, 7.0);
  EXPECT_EQ(decision.Decision(3, x), 24);
  EXPECT_EQ(decision.LogDecision(3, x, gradient), 24);
  EXPECT_EQ(gradient, (std::vector<double>{0, 0, 0, 1, 10, 0, 0, 0}));
  x[4] = std::nan("");
  EXPECT_EQ(decision.Decision(3, x), -HUGE_VAL);
  EXPECT_EQ(decision.LogDecision(3, x, gradient), -HUGE_VAL);
  EXPECT_EQ(gradient, std::vector<double>(8, 0.0));
}

TEST(FeatureDecisionTest, AStateOfTheWrongSizeIsOutside) {
  const Planar inner;
  const FeatureDecision decision(Object(), inner);
  constexpr double kOutside = -std::numeric_limits<double>::infinity();
  const std::vector<double> x(7, 0.0);
  std::vector<double> gradient(8, 1.0);
  EXPECT_EQ(decision.Decision(0, x), kOutside);
  EXPECT_EQ(decision.LogDecision(0, x, gradient), kOutside);
  EXPECT_EQ(gradient, std::vector<double>(8, 0.0));
  gradient.assign(7, 1.0);
  EXPECT_EQ(decision.Gradient(0, kState, gradient), kOutside);
  EXPECT_EQ(gradient, std::vector<double>(7, 0.0));
}

TEST(FeatureDecisionTest, RefusesFeaturesOfAnotherSize) {
  const Planar inner;
  EXPECT_THROW(FeatureDecision(FeatureTransform::Identity(Named("tip")), inner),
               std::invalid_argument);
}

}  // namespace
}  // namespace dfr::core
