#include "dfr/runtime/periodic_timer.h"

#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mman.h>

#include <chrono>
#include <stdexcept>
#include <string>
#include <thread>

#include "tests/support/no_alloc.h"

namespace dfr::runtime {
namespace {

TEST(PeriodicTimerTest, NeverWakesEarlyAndLeavesOutWhatIsOver) {
  const std::int64_t start = SteadyNow();
  PeriodicTimer timer(0.005);
  for (int i = 1; i <= 20; ++i) {
    timer.Wait();
    EXPECT_GE(SteadyNow() - start, i * 5'000'000) << "period " << i;
  }
  const std::int64_t missed = timer.missed();
  std::this_thread::sleep_for(std::chrono::milliseconds(28));
  timer.Wait();  // at once: five periods and more are over
  const std::int64_t woken = SteadyNow();
  EXPECT_GE(timer.missed() - missed, 4);
  timer.Wait();
  // The next end of a period on the grid of the first, not a burst of those that were missed.
  EXPECT_GE(SteadyNow() - start, timer.periods() * 5'000'000);
  EXPECT_GT(SteadyNow(), woken);
  EXPECT_EQ(timer.periods(), 22);
}

TEST(PeriodicTimerTest, BooksWhatItWasHeldUp) {
  PeriodicTimer timer(0.001);
  for (int i = 0; i < 9; ++i) timer.Wait();
  std::this_thread::sleep_for(std::chrono::milliseconds(12));
  timer.Wait();
  EXPECT_GE(timer.worst(), 0.010);  // 12 ms after the last, 1 ms being due, less rounding
  EXPECT_GE(timer.Jitter(1.0), 0.010);
  EXPECT_LE(timer.Jitter(0.5), timer.Jitter(0.9));
}

TEST(PeriodicTimerTest, ClocksAreInNanoseconds) {
  const auto wall = std::chrono::system_clock::now().time_since_epoch();
  EXPECT_GE(WallNow(), std::chrono::nanoseconds(wall).count());
  const std::int64_t before = SteadyNow();
  std::this_thread::sleep_for(std::chrono::milliseconds(2));
  EXPECT_GE(SteadyNow() - before, 2'000'000);
}

// Granted or not, which depends on the user's rights, the program goes on, and knows.
TEST(PeriodicTimerTest, RealTimeIsGrantedOrTheMissingRightIsNamed) {
  std::string refused;
  int granted = -1;
  std::thread([&] {
    refused = AskForRealTime(1);
    granted = sched_getscheduler(0);
    GiveUpRealTime();
    EXPECT_EQ(sched_getscheduler(0), SCHED_OTHER);
  }).join();
  munlockall();
  EXPECT_EQ(granted == SCHED_FIFO, refused.find("no real-time scheduling") == std::string::npos)
      << refused;
}

TEST(PeriodicTimerTest, ThrowsForPeriodsOutOfRange) {
  EXPECT_THROW(PeriodicTimer(0.0), std::invalid_argument);
  EXPECT_THROW(PeriodicTimer(11.0), std::invalid_argument);
}

TEST(PeriodicTimerTest, NeverAllocates) {
  PeriodicTimer timer(0.001);
  const test::NoAlloc no_alloc;
  for (int i = 0; i < 3; ++i) timer.Wait();
  EXPECT_GE(timer.Jitter(0.5), 0.0);
}

}  // namespace
}  // namespace dfr::runtime
