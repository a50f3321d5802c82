#include "dfr/runtime/periodic_timer.h"

#include <gtest/gtest.h>

#include <stdexcept>

#include "tests/runtime/hand_clock.h"

namespace dfr::runtime {
namespace {

constexpr std::int64_t kMs = 1'000'000;

class PeriodicTimerTest : public testing::Test {
 protected:
  test::SteadyHandClock clock_;
  const std::int64_t start_ns_ = clock_.now_ns;
  PeriodicTimer timer_{0.005, clock_};
};

TEST_F(PeriodicTimerTest, WakesAtTheEndOfEachPeriodFromTheFirst) {
  for (int i = 1; i <= 20; ++i) {
    clock_.now_ns += i % 5 * kMs;  // the work of the loop
    timer_.Wait();
    EXPECT_EQ(clock_.now_ns, start_ns_ + i * 5 * kMs);
  }
  EXPECT_EQ(timer_.periods(), 20);
  EXPECT_EQ(timer_.missed(), 0);
  EXPECT_EQ(timer_.worst(), 0.0);
}

TEST_F(PeriodicTimerTest, SkipsMissedPeriodsAndStaysOnTheGrid) {
  timer_.Wait();
  clock_.now_ns += 28 * kMs;  // delayed until 33 ms after the start
  timer_.Wait();
  EXPECT_EQ(clock_.now_ns, start_ns_ + 33 * kMs) << "at once";
  EXPECT_EQ(timer_.missed(), 4) << "those that end at 15, 20, 25 and 30 ms";
  timer_.Wait();
  EXPECT_EQ(clock_.now_ns, start_ns_ + 35 * kMs) << "no burst of missed periods";
  EXPECT_EQ(timer_.periods(), 3);
  EXPECT_EQ(timer_.missed(), 4);
}

TEST_F(PeriodicTimerTest, APeriodThatEndsNowIsNotMissed) {
  clock_.now_ns += 5 * kMs;
  timer_.Wait();
  EXPECT_EQ(clock_.now_ns, start_ns_ + 5 * kMs);
  clock_.now_ns += 10 * kMs - 1;
  timer_.Wait();
  EXPECT_EQ(timer_.missed(), 0);
  clock_.now_ns = start_ns_ + 20 * kMs;
  timer_.Wait();
  EXPECT_EQ(timer_.missed(), 1);
}

TEST_F(PeriodicTimerTest, RecordsTheErrorsOfPeriods) {
  EXPECT_EQ(timer_.Jitter(0.5), 0.0) << "nothing is known yet";
  for (int i = 0; i < 8; ++i) timer_.Wait();
  clock_.late_ns = 3 * kMs;
  timer_.Wait();  // 3 ms late
  clock_.late_ns = 0;
  timer_.Wait();  // on time, and 3 ms less than a period after the previous one
  EXPECT_DOUBLE_EQ(timer_.worst(), 0.003);
  // The resolution is 1 us.
  EXPECT_DOUBLE_EQ(timer_.Jitter(0.8), 1e-6);
  EXPECT_DOUBLE_EQ(timer_.Jitter(0.81), 0.003001);
  EXPECT_DOUBLE_EQ(timer_.Jitter(1.0), 0.003001);
  clock_.now_ns += 100 * kMs;
  timer_.Wait();
  EXPECT_DOUBLE_EQ(timer_.worst(), 0.095);
  EXPECT_DOUBLE_EQ(timer_.Jitter(1.0), 0.020001) << "larger errors share one bin";
}

TEST_F(PeriodicTimerTest, ThrowsForPeriodsOutOfRange) {
  for (const double period_s : {0.0, 0.000099, 10.1, -1.0}) {
    EXPECT_THROW(PeriodicTimer(period_s, clock_), std::invalid_argument) << period_s;
  }
}

}  // namespace
}  // namespace dfr::runtime
