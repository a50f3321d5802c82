#include "dfr/core/files/read_budget.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <limits>

namespace dfr::core {
namespace {

constexpr std::uint64_t kMost = std::numeric_limits<std::uint64_t>::max();

TEST(ReadBudgetTest, IsBoundedByTheSizeOfTheFile) {
  EXPECT_EQ(ReadBudget(0).left(), ReadBudget::kAllowance);
  EXPECT_EQ(ReadBudget(1000).left(), ReadBudget::kAllowance + 1000 * ReadBudget::kPerByte);
  EXPECT_EQ(ReadBudget(kMost).left(), kMost);
}

TEST(ReadBudgetTest, GrantedBytesAreSpentAndRefusedOnesAreNot) {
  ReadBudget budget(0);
  EXPECT_TRUE(budget.Take(3, 1 << 20));
  EXPECT_EQ(budget.left(), ReadBudget::kAllowance - (3 << 20));
  EXPECT_FALSE(budget.Take(1, ReadBudget::kAllowance));
  EXPECT_EQ(budget.left(), ReadBudget::kAllowance - (3 << 20));
  EXPECT_TRUE(budget.Take(1, budget.left()));
  EXPECT_FALSE(budget.Take(1, 1));
  EXPECT_TRUE(budget.Take(kMost, 0));
}

TEST(ReadBudgetTest, ProductsThatOverflowAreRefused) {
  ReadBudget budget(0);
  EXPECT_FALSE(budget.Take(kMost, kMost));
  EXPECT_FALSE(budget.Take(std::uint64_t{1} << 32, std::uint64_t{1} << 32));
}

}  // namespace
}  // namespace dfr::core
