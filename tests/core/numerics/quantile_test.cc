#include "dfr/core/numerics/quantile.h"

#include <gtest/gtest.h>

#include <span>
#include <vector>

#include "tests/support/no_alloc.h"

namespace dfr::core {
namespace {

TEST(QuantileTest, MedianIsTheMiddleOneOrTheUpperOfTwo) {
  std::vector<int> five = {9, 1, 7, 3, 5};
  EXPECT_EQ(Median(five), 5);
  EXPECT_EQ(Median(std::vector{4.0, 1.0, 3.0, 2.0}), 3.0);
  EXPECT_EQ(Median(std::vector{2.5}), 2.5);
}

TEST(QuantileTest, IsTheValueOfTheRankBelow) {
  const std::vector<double> values = {50.0, 10.0, 40.0, 20.0, 30.0};  // ranks 4, 0, 3, 1, 2
  const auto quantile = [&](double q) { return Quantile(std::vector(values), q); };
  EXPECT_EQ(quantile(0.0), 10.0);
  EXPECT_EQ(quantile(0.49), 20.0);  // 0.49 * 4 = 1.96
  EXPECT_EQ(quantile(0.5), 30.0);
  EXPECT_EQ(quantile(0.99), 40.0);
  EXPECT_EQ(quantile(1.0), 50.0);
  EXPECT_EQ(ValueOfRank(std::vector(values), 3), 40.0);
}

TEST(QuantileTest, WorksInPlaceWithoutAllocating) {
  std::vector<int> values = {3, 1, 2};
  const test::NoAlloc guard;
  EXPECT_EQ(Median(std::span(values)), 2);
  EXPECT_EQ(Quantile(values, 1.0), 3);
}

}  // namespace
}  // namespace dfr::core
