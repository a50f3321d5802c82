#include "dfr/core/random.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numeric>
#include <set>
#include <vector>

namespace dfr::core {
namespace {

// From the authors' reference code (prng.di.unimi.it): xoshiro256++ behind SplitMix64 with seed 0.
// SplitMix64(0) begins e220a8397b1dcdaf 6e789e6aa1b965f4 06c45d188009454f f88bb8a8724c81ec, and the
// first output is rotl(s0 + s3, 23) + s0.
TEST(RandomTest, FirstOutputIsXoshiroOfSplitMixState) {
  const std::uint64_t s0 = 0xe220a8397b1dcdafu;
  const std::uint64_t s3 = 0xf88bb8a8724c81ecu;
  const std::uint64_t sum = s0 + s3;
  const std::uint64_t expected = ((sum << 23) | (sum >> 41)) + s0;
  Random random(0);
  EXPECT_EQ(random(), expected);
}

TEST(RandomTest, StreamsOfDifferentPathsShareNoSeed) {
  std::set<std::uint64_t> seeds;
  for (std::uint64_t trial = 0; trial < 100; ++trial) {
    for (std::uint64_t episode = 0; episode < 100; ++episode) {
      seeds.insert(DeriveSeed(7, {trial, episode}));
    }
    seeds.insert(DeriveSeed(7, {trial}));
  }
  EXPECT_EQ(seeds.size(), 100u * 100u + 100u);
  EXPECT_NE(DeriveSeed(7, {1, 2}), DeriveSeed(8, {1, 2}));
}

TEST(RandomTest, UniformFillsItsBinsEvenly) {
  constexpr int kBins = 64;
  constexpr int kDraws = 64000;
  std::vector<int> counts(kBins, 0);
  Random random(3);
  for (int i = 0; i < kDraws; ++i) {
    const double u = random.Uniform();
    ASSERT_GE(u, 0.0);
    ASSERT_LT(u, 1.0);
    ++counts[static_cast<std::size_t>(u * kBins)];
  }
  double chi_squared = 0.0;
  for (const int count : counts) chi_squared += (count - 1000.0) * (count - 1000.0) / 1000.0;
  EXPECT_LT(chi_squared, 103.4);  // 63 degrees of freedom, 0.1 % tail
}

// The numbers of a seed never change. Marsaglia and Bray's polar method draws pairs of uniform
// numbers in [-1, 1) until a pair lies inside the unit circle.
TEST(RandomTest, NormalIsThePolarMethodOfTheUniformStream) {
  Random normal(9);
  Random uniform(9);
  for (int pair = 0; pair < 1000; ++pair) {
    double u = 0.0, v = 0.0, square = 1.0;
    while (square >= 1.0) {
      u = 2.0 * uniform.Uniform() - 1.0;
      v = 2.0 * uniform.Uniform() - 1.0;
      square = u * u + v * v;
    }
    const double scale = std::sqrt(-2.0 * std::log(square) / square);
    ASSERT_DOUBLE_EQ(normal.Normal(), u * scale) << pair;
    ASSERT_DOUBLE_EQ(normal.Normal(), v * scale) << pair;
  }
}

TEST(RandomTest, BelowReachesEveryValueAndNoOther) {
  Random random(5);
  std::vector<int> counts(7, 0);
  for (int i = 0; i < 7000; ++i) ++counts.at(random.Below(7));
  for (const int count : counts) EXPECT_NEAR(count, 1000, 4 * std::sqrt(7000 * 6.0 / 49.0));
}

TEST(RandomTest, DirectionIsAUnitVectorOfMeanZero) {
  Random random(6);
  std::vector<double> mean(7, 0.0), direction(7);
  for (int i = 0; i < 10000; ++i) {
    random.Direction(direction);
    const double norm =
        std::sqrt(std::inner_product(direction.begin(), direction.end(), direction.begin(), 0.0));
    ASSERT_NEAR(norm, 1.0, 1e-14);
    for (std::size_t k = 0; k < 7; ++k) mean[k] += direction[k] / 10000;
  }
  for (const double m : mean) EXPECT_NEAR(m, 0.0, 4.0 / std::sqrt(7.0 * 10000.0));
}

TEST(RandomTest, ShuffleKeepsTheItemsAndChangesTheOrder) {
  std::vector<int> items(50);
  std::iota(items.begin(), items.end(), 0);
  const std::vector<int> before = items;
  Random random(8);
  random.Shuffle(std::span<int>(items));
  EXPECT_NE(items, before);
  EXPECT_THAT(items, testing::UnorderedElementsAreArray(before));
}

}  // namespace
}  // namespace dfr::core
