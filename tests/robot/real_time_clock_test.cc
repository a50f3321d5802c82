#include "dfr/robot/real_time_clock.h"

#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "tests/support/no_alloc.h"

namespace dfr::robot {
namespace {

TEST(RealTimeClockTest, CountsPeriodsFromTheFirstWaitAndThenAllocatesNothing) {
  RealTimeClock clock(0.002);
  EXPECT_EQ(clock.timer(), nullptr);
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  const std::int64_t start_ns = clock.SteadyNs();
  EXPECT_TRUE(clock.Wait(0.002).ok());
  {
    const test::NoAlloc no_alloc;
    for (int i = 1; i < 5; ++i) EXPECT_TRUE(clock.Wait(123.0).ok()) << "periods have one length";
  }
  EXPECT_GE(clock.SteadyNs() - start_ns, 5 * 2'000'000);
  EXPECT_EQ(clock.timer()->periods(), 5);
  // What passed before the first call is no missed period; on a busy machine others may be.
  EXPECT_LT(2e-3 * static_cast<double>(clock.timer()->missed()),
            1e-9 * static_cast<double>(clock.SteadyNs() - start_ns));
  EXPECT_FALSE(clock.lock_step());
}

}  // namespace
}  // namespace dfr::robot
