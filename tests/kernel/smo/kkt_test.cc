#include "smo/kkt.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "dfr/core/random.h"
#include "gaussian/gaussian_sum.h"

namespace dfr::kernel::internal {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

// Random alpha, about a third of them 0 and a third of them 1, and random G.
struct Sample {
  explicit Sample(std::size_t count) : alpha(count), gradient(count) {
    core::Random random(count);
    for (double& a : alpha) a = std::clamp(random.Uniform(-1.0, 2.0), 0.0, 1.0);
    for (double& g : gradient) g = random.Normal();
  }
  std::vector<double> alpha;
  std::vector<double> gradient;
};

TEST(KktBoundsTest, EveryInstructionSetGivesTheBitsOfTheDefinition) {
  for (std::size_t count = 0; count <= 70; ++count) {
    const Sample s(count);
    KktBounds expected;
    for (std::size_t i = 0; i < count; ++i) {
      if (s.alpha[i] > 0.0) expected.largest = std::max(expected.largest, s.gradient[i]);
      if (s.alpha[i] < 1.0) expected.smallest = std::min(expected.smallest, s.gradient[i]);
      if (s.alpha[i] > 0.0 && s.alpha[i] < 1.0) {
        expected.free_sum += s.gradient[i];
        ++expected.free;
      }
      expected.alpha_sum += s.alpha[i];
      expected.weighted_sum += s.alpha[i] * s.gradient[i];
    }
    for (const std::int64_t target : SupportedTargets()) {
      SCOPED_TRACE(testing::Message() << count << " samples, " << TargetName(target));
      ForceTarget(target);
      const KktBounds bounds(s.alpha, s.gradient);
      ForceTarget(0);
      EXPECT_EQ(bounds.largest, expected.largest);
      EXPECT_EQ(bounds.smallest, expected.smallest);
      EXPECT_EQ(bounds.free_sum, expected.free_sum);
      EXPECT_EQ(bounds.free, expected.free);
      EXPECT_EQ(bounds.alpha_sum, expected.alpha_sum);
      EXPECT_EQ(bounds.weighted_sum, expected.weighted_sum);
    }
  }
}

TEST(KktBoundsTest, NoNanIsAnExtremeButTheObjectiveShowsIt) {
  for (const std::int64_t target : SupportedTargets()) {
    ForceTarget(target);
    for (std::size_t i = 0; i < 20; ++i) {
      Sample s(20);
      s.alpha.assign(20, 0.0);
      s.gradient[i] = std::nan("");
      const KktBounds bounds(s.alpha, s.gradient);
      EXPECT_EQ(bounds.largest, -kInfinity);
      EXPECT_LT(bounds.smallest, kInfinity);
      EXPECT_TRUE(std::isnan(bounds.weighted_sum)) << TargetName(target) << ", sample " << i;
    }
    ForceTarget(0);
  }
}

}  // namespace
}  // namespace dfr::kernel::internal
