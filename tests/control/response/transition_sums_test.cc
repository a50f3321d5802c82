#include "transition_sums.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <tuple>
#include <vector>

#include "dfr/core/random.h"
#include "hwy/highway.h"

namespace dfr::control::internal {
namespace {

// Every test runs with several numbers of rows on each instruction set of this machine.
class TransitionSumsTest : public testing::TestWithParam<std::tuple<std::size_t, std::int64_t>> {
 protected:
  TransitionSumsTest() { hwy::GetChosenTarget().Update(std::get<1>(GetParam())); }
  ~TransitionSumsTest() override { hwy::GetChosenTarget().DeInit(); }

  [[nodiscard]] static std::size_t Rows() { return std::get<0>(GetParam()); }
  std::vector<float> Uniform(std::size_t count) {
    std::vector<float> values(count);
    for (float& value : values) value = static_cast<float>(random_.Uniform(-1.0, 1.0));
    return values;
  }

  core::Random random_{7};
};

TEST_P(TransitionSumsTest, DistancesAndWeightsAreTheirDefinitions) {
  constexpr std::size_t kDim = 5;
  constexpr double kScale = 0.7;
  const std::size_t rows = Rows();
  const std::size_t stride = rows + kPadding;
  const std::vector<float> points = Uniform(stride * kDim);
  const std::vector<float> z = Uniform(kDim);
  std::vector<float> distances(rows + kPadding);
  const float least =
      SquaredDistances(points.data(), stride, kDim, z.data(), rows, distances.data());
  EXPECT_EQ(least, *std::min_element(distances.begin(), distances.begin() + rows));
  // Selects every third row, in reverse order.
  constexpr double kFloor = 0.01;
  std::vector<std::int32_t> indices;
  for (std::size_t i = rows; i-- > 0;) {
    if (i % 3 == 0) indices.push_back(static_cast<std::int32_t>(i));
  }
  const std::size_t count = indices.size();
  indices.resize(count + kPadding);
  std::vector<double> weights(count + kPadding);
  const double sum =
      Weights(distances.data(), indices.data(), count, least, kScale, kFloor, weights.data());
  double expected_sum = 0.0;
  for (std::size_t k = 0; k < count; ++k) {
    const double distance = distances[static_cast<std::size_t>(indices[k])];
    const double weight = std::exp(-kScale * (distance - least)) + kFloor;
    EXPECT_NEAR(weights[k], weight, 1e-14);
    expected_sum += weights[k];
  }
  EXPECT_EQ(sum, expected_sum);
  for (std::size_t i = 0; i < rows; ++i) {
    double expected = 0.0;
    for (std::size_t k = 0; k < kDim; ++k) {
      expected += std::pow(static_cast<double>(points[k * stride + i]) - z[k], 2.0);
    }
    EXPECT_NEAR(distances[i], expected, 1e-6 * expected);
  }
}

TEST_P(TransitionSumsTest, DistancesThatOverflowAreNamed) {
  const std::size_t rows = Rows();
  std::vector<float> points(rows + kPadding, 0.0F);
  std::vector<float> distances(rows + kPadding);
  const float z = 0.0F;
  for (const float far : {1e20F, std::numeric_limits<float>::quiet_NaN()}) {
    points[rows - 1] = far;
    EXPECT_TRUE(
        std::isnan(SquaredDistances(points.data(), points.size(), 1, &z, rows, distances.data())));
  }
  // Padding does not count.
  points[rows - 1] = 1.0F;
  points[rows] = std::numeric_limits<float>::quiet_NaN();
  const float least = SquaredDistances(points.data(), points.size(), 1, &z, rows, distances.data());
  EXPECT_EQ(least, rows == 1 ? 1.0F : 0.0F);
}

TEST_P(TransitionSumsTest, NearestAgreesWithASort) {
  const std::size_t rows = Rows();
  std::vector<float> distances(rows);
  // Distances have few values: many are equal, and some are maximal.
  for (float& d : distances) d = static_cast<float>(std::floor(random_.Uniform(0.0, 9.0)));
  distances.back() = std::numeric_limits<float>::infinity();
  std::vector<std::int32_t> sorted(rows);
  std::iota(sorted.begin(), sorted.end(), 0);
  std::stable_sort(sorted.begin(), sorted.end(), [&](std::int32_t a, std::int32_t b) {
    return distances[static_cast<std::size_t>(a)] < distances[static_cast<std::size_t>(b)];
  });
  for (std::size_t count = 1, next = 0; count <= rows; count = next) {
    // The last count is the number of all rows.
    next = count == rows ? rows + 1 : std::min(rows, count + 1 + count / 2);
    std::vector<std::int32_t> nearest(count + 1, -1);
    Nearest(distances.data(), rows, count, nearest.data());
    nearest.resize(count);
    std::sort(nearest.begin(), nearest.end());
    std::vector<std::int32_t> expected(sorted.begin(),
                                       sorted.begin() + static_cast<std::ptrdiff_t>(count));
    std::sort(expected.begin(), expected.end());
    EXPECT_EQ(nearest, expected) << count << " of " << rows;
  }
}

// Tests widths around one narrow vector, one wide vector, and three wide vectors.
TEST_P(TransitionSumsTest, SumsAreThoseOfWeightedOuterProducts) {
  constexpr std::size_t kLeft = kWidth;
  constexpr double kFactor = 3.0;
  const std::size_t rows = Rows();
  for (std::size_t width = kWidth; width <= 9 * kWidth; width += kWidth) {
    SCOPED_TRACE(width);
    const std::vector<float> table = Uniform(rows * width);
    const std::vector<float> z = Uniform(width);
    std::vector<double> weights(rows);
    for (double& weight : weights) weight = random_.Uniform(0.0, 1.0);
    // Selects every second row, in reverse order.
    std::vector<std::int32_t> indices;
    for (std::size_t i = rows; i-- > 0;) {
      if (i % 2 == 0) indices.push_back(static_cast<std::int32_t>(i));
    }
    std::vector<double> chosen;
    for (const std::int32_t i : indices) chosen.push_back(weights[static_cast<std::size_t>(i)]);
    std::vector<float> tile(kTile * (kLeft + width));
    std::vector<float> sums(kLeft * width);
    WeightedSumsAbout(z.data(), table.data(), width, indices.data(), chosen.data(), kFactor,
                      indices.size(), kLeft, tile.data(), sums.data());
    // Sums the same rows in ascending order, without subtracting z.
    std::reverse(chosen.begin(), chosen.end());
    std::vector<float> plain(kLeft * width);
    WeightedSums(table.data(), kLeft, table.data(), width, 2 * width, chosen.data(), kFactor,
                 chosen.size(), tile.data(), plain.data(), width);
    for (std::size_t a = 0; a < kLeft; ++a) {
      for (std::size_t b = 0; b < width; ++b) {
        double expected = 0.0;
        double size = 0.0;
        double expected_plain = 0.0;
        double size_plain = 0.0;
        for (std::size_t i = 0; i < rows; i += 2) {
          const auto left = static_cast<double>(table[i * width + a]);
          const auto right = static_cast<double>(table[i * width + b]);
          const double term = kFactor * weights[i] * (left - z[a]) * (right - z[b]);
          const double plain_term = kFactor * weights[i] * left * right;
          expected += term;
          size += std::abs(term);
          expected_plain += plain_term;
          size_plain += std::abs(plain_term);
        }
        EXPECT_NEAR(sums[a * width + b], expected, 1e-6 * size) << a << ", " << b;
        EXPECT_NEAR(plain[a * width + b], expected_plain, 1e-6 * size_plain) << a << ", " << b;
      }
    }
  }
}

// The rows fill less than a vector, whole vectors, or whole vectors plus a remainder.
INSTANTIATE_TEST_SUITE_P(Rows, TransitionSumsTest,
                         testing::Combine(testing::Values(1, 16, 31, 64, 527),
                                          testing::ValuesIn(hwy::SupportedAndGeneratedTargets())));

}  // namespace
}  // namespace dfr::control::internal
