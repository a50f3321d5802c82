// Values handed from one thread to another.
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <thread>

#include "dfr/runtime/latest.h"
#include "dfr/runtime/queue.h"
#include "tests/support/no_alloc.h"

namespace dfr::runtime {
namespace {

TEST(LatestTest, TakesEachValueOnceAndTheNewestOnly) {
  Latest<int> latest;
  int value = -1;
  EXPECT_FALSE(latest.Take(value));
  EXPECT_EQ(value, -1);
  latest.Put(1);
  ASSERT_TRUE(latest.Take(value));
  EXPECT_EQ(value, 1);
  EXPECT_FALSE(latest.Take(value));
  latest.Put(2);
  latest.Put(3);
  ASSERT_TRUE(latest.Take(value));
  EXPECT_EQ(value, 3);
  EXPECT_FALSE(latest.Take(value));
}

// All entries of a value are its number: an incomplete value would mix two numbers.
TEST(LatestTest, HandsWholeValuesInOrderBetweenThreads) {
  using Value = std::array<std::int64_t, 32>;
  Latest<Value> latest;
  constexpr std::int64_t kValues = 200'000;
  std::thread writer([&] {
    Value value;
    for (std::int64_t i = 1; i <= kValues; ++i) {
      value.fill(i);
      latest.Put(value);
    }
  });
  std::int64_t last = 0;
  bool torn = false;
  bool ordered = true;
  Value value{};
  while (last < kValues) {
    if (!latest.Take(value)) continue;
    for (const std::int64_t entry : value) torn = torn || entry != value[0];
    ordered = ordered && value[0] > last;
    last = value[0];
  }
  writer.join();
  EXPECT_FALSE(torn);
  EXPECT_TRUE(ordered);
}

TEST(LatestTest, NeverAllocates) {
  Latest<int> latest;
  int value = 0;
  const test::NoAlloc no_alloc;
  for (int i = 0; i < 10; ++i) {
    latest.Put(i);
    ASSERT_TRUE(latest.Take(value));
  }
}

TEST(QueueTest, ValuesComeInOrderUntilItIsFull) {
  Queue<int, 3> queue;
  int value = 7;
  EXPECT_FALSE(queue.Take(value));
  EXPECT_EQ(value, 7);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(queue.Put(i));
  EXPECT_FALSE(queue.Put(3));
  for (int i = 0; i < 3; ++i) {
    EXPECT_TRUE(queue.Take(value));
    EXPECT_EQ(value, i);
  }
  EXPECT_FALSE(queue.Take(value));
}

TEST(QueueTest, NothingIsLostBetweenTwoThreads) {
  constexpr int kValues = 20'000;
  Queue<int, 16> queue;
  std::thread writer([&] {
    for (int i = 0; i < kValues; ++i) {
      while (!queue.Put(i)) std::this_thread::yield();
    }
  });
  for (int i = 0; i < kValues; ++i) {
    int value = -1;
    while (!queue.Take(value)) std::this_thread::yield();
    ASSERT_EQ(value, i);
  }
  writer.join();
}

}  // namespace
}  // namespace dfr::runtime
