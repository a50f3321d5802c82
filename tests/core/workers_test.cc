#include "dfr/core/workers.h"

#include <gtest/gtest.h>

#include <atomic>
#include <stdexcept>
#include <vector>

namespace dfr::core {
namespace {

TEST(WorkersTest, EveryJobIsDoneOnce) {
  for (const int threads : {0, 1, 2, 7}) {
    Workers workers(threads);
    for (const std::size_t count : {0, 1, 2, 5, 1000, 3}) {
      std::vector<std::atomic<int>> done(count);
      workers.Run(count, [&](std::size_t i) { ++done[i]; });
      for (const auto& times : done) EXPECT_EQ(times, 1);
    }
  }
}

TEST(WorkersTest, NoMoreThreadsThanJobsAreStarted) {
  Workers workers(1'000'000);
  std::atomic<int> done = 0;
  workers.Run(3, [&](std::size_t) { ++done; });
  EXPECT_EQ(done, 3);
}

TEST(WorkersTest, AJobsExceptionIsThrownAndTheWorkersStayUsable) {
  for (const int threads : {1, 4}) {
    Workers workers(threads);
    const auto fail = [](std::size_t i) {
      if (i == 17) throw std::runtime_error("seventeen");
    };
    EXPECT_THROW(workers.Run(100, fail), std::runtime_error);
    std::atomic<int> done = 0;
    workers.Run(100, [&](std::size_t) { ++done; });
    EXPECT_EQ(done, 100);
  }
  EXPECT_THROW(Workers(-1), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::core
