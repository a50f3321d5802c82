#include "dfr/runtime/queue.h"

#include <gtest/gtest.h>

#include <thread>

namespace dfr::runtime {
namespace {

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
  constexpr int kValues = 100'000;
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
