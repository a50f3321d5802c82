#include "smo/starts.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <vector>

namespace dfr::kernel::internal {
namespace {

using Alpha = std::vector<double>;

TEST(StartsTest, FillTakesTheFirstOfTheOrder) {
  const std::vector<std::size_t> order = {3, 0, 2, 1};
  EXPECT_EQ(Fill(order, 4, 2.5), (Alpha{1.0, 0.0, 0.5, 1.0}));
  EXPECT_EQ(Fill(order, 4, 0.25), (Alpha{0.0, 0.0, 0.0, 0.25}));
  EXPECT_EQ(Fill(order, 4, 4.0), (Alpha{1.0, 1.0, 1.0, 1.0}));
}

TEST(StartsTest, EvenlySpreadLeavesEqualIntervals) {
  EXPECT_EQ(EvenlySpread(6, 3.0), (Alpha{1.0, 0.0, 1.0, 0.0, 1.0, 0.0}));
  EXPECT_EQ(EvenlySpread(6, 1.5), (Alpha{1.0, 0.0, 0.0, 0.5, 0.0, 0.0}));
  EXPECT_EQ(EvenlySpread(3, 3.0), (Alpha{1.0, 1.0, 1.0}));
}

TEST(StartsTest, AStartIsScaledClippedAndFilledUp) {
  EXPECT_EQ(Feasible(Alpha{1.0, 3.0, 0.0}, 1.0), (Alpha{0.25, 0.75, 0.0}));
  // 1.5 is clipped. The rest goes to the other support vector, not to the first sample.
  EXPECT_EQ(Feasible(Alpha{0.0, 0.5, 1.5}, 2.0), (Alpha{0.0, 1.0, 1.0}));
  EXPECT_EQ(Feasible(Alpha{0.0, 0.5, 0.5}, 2.5), (Alpha{0.5, 1.0, 1.0}));
}

}  // namespace
}  // namespace dfr::kernel::internal
