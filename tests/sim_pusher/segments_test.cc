#include "segments.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "dfr/core/random.h"

namespace dfr::sim::internal {
namespace {

double Sampled(const Segment& p, const Segment& q) {
  constexpr int kSamples = 200;
  double least = 1e300;
  for (int i = 0; i <= kSamples; ++i) {
    for (int j = 0; j <= kSamples; ++j) {
      double squared = 0.0;
      for (int k = 0; k < 3; ++k) {
        const double s = static_cast<double>(i) / kSamples;
        const double t = static_cast<double>(j) / kSamples;
        const double d = p.a[k] + s * (p.b[k] - p.a[k]) - q.a[k] - t * (q.b[k] - q.a[k]);
        squared += d * d;
      }
      least = std::min(least, squared);
    }
  }
  return least;
}

// Segments shorter than 2 have 201 samples each, so the samples nearest to the optimum are within
// 0.01. The sampled squared distance exceeds the true value by at most 0.01^2 for an interior
// optimum. For an optimum at an end, where the sample is exact, the excess is at most 2 * distance
// * 0.01.
TEST(SquaredDistanceTest, IsTheLeastOverBothSegments) {
  core::Random random(11);
  for (int i = 0; i < 60; ++i) {
    SCOPED_TRACE(i);
    Segment p;
    Segment q;
    for (Point* point : {&p.a, &p.b, &q.a, &q.b}) {
      for (double& x : *point) x = random.Uniform(-0.5, 0.5);
    }
    if (i % 3 == 0) q.b = {q.a[0], q.a[1], q.a[2] + 0.3};
    const double exact = SquaredDistance(p, q);
    const double sampled = Sampled(p, q);
    EXPECT_LE(exact, sampled + 1e-14);
    EXPECT_GE(exact, sampled - 2e-4);
    EXPECT_NEAR(exact, SquaredDistance(q, p), 1e-14);
  }
}

TEST(SquaredDistanceTest, HandlesParallelCrossingAndDegenerateSegments) {
  const Segment along_x{{0, 0, 0}, {2, 0, 0}};
  EXPECT_DOUBLE_EQ(SquaredDistance(along_x, {{1, 3, 0}, {5, 3, 0}}), 9.0);
  EXPECT_DOUBLE_EQ(SquaredDistance(along_x, {{5, 4, 0}, {9, 4, 0}}), 25.0);
  EXPECT_DOUBLE_EQ(SquaredDistance(along_x, {{-4, 3, 0}, {-9, 3, 0}}), 25.0);
  EXPECT_DOUBLE_EQ(SquaredDistance(along_x, {{1, -1, 0}, {1, 1, 0}}), 0.0);
  EXPECT_DOUBLE_EQ(SquaredDistance(along_x, {{1, 0, 2}, {1, 0, 2}}), 4.0);
  EXPECT_DOUBLE_EQ(SquaredDistance({{0, 0, 0}, {0, 0, 0}}, {{3, 4, 0}, {3, 4, 0}}), 25.0);
}

}  // namespace
}  // namespace dfr::sim::internal
