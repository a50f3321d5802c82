#include "dfr/robot/real_time_clock.h"

#include <gtest/gtest.h>

#include "tests/runtime/hand_clock.h"
#include "tests/support/no_alloc.h"

namespace dfr::robot {
namespace {

TEST(RealTimeClockTest, CountsPeriodsFromTheFirstWaitAndThenAllocatesNothing) {
  test::SteadyHandClock machine;
  RealTimeClock clock(0.002, machine);
  EXPECT_EQ(clock.timer(), nullptr);
  machine.now_ns += 20'000'000;
  const std::int64_t start_ns = clock.SteadyNs();
  EXPECT_TRUE(clock.Wait(0.002).ok());
  {
    const test::NoAlloc no_alloc;
    for (int i = 1; i < 5; ++i) EXPECT_TRUE(clock.Wait(123.0).ok()) << "periods have one length";
  }
  EXPECT_EQ(clock.SteadyNs() - start_ns, 5 * 2'000'000);
  EXPECT_EQ(clock.MachineNs(), machine.now_ns);
  EXPECT_EQ(clock.timer()->periods(), 5);
  EXPECT_EQ(clock.timer()->missed(), 0)
      << "the time before the first call counts as no missed period";
  EXPECT_FALSE(clock.lock_step());
}

}  // namespace
}  // namespace dfr::robot
