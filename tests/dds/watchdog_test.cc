#include "dfr/dds/watchdog.h"

#include <gtest/gtest.h>

#include <limits>
#include <stdexcept>

#include "tests/support/no_alloc.h"

namespace dfr::dds {
namespace {

constexpr std::int64_t kMillisecond = 1'000'000;
constexpr std::int64_t kWallClock = 1'700'000'000'123'456'789;  // not a whole second
constexpr std::int64_t kSteady = 5'000 * kMillisecond;

Watchdog Make() {
  return Watchdog({.max_age_s = 0.05, .max_silence_s = 0.04, .max_ahead_s = 0.01});
}

TEST(StampTest, NanosecondsRoundTrip) {
  for (const std::int64_t ns :
       {std::int64_t{0}, std::int64_t{1}, kWallClock, -kWallClock, 999 * kMillisecond}) {
    EXPECT_EQ(Stamp::FromNanoseconds(ns).nanoseconds(), ns);
    EXPECT_LT(Stamp::FromNanoseconds(ns).nanosec, 1'000'000'000U);
  }
  EXPECT_FALSE(Stamp{}.valid());
  EXPECT_TRUE(Stamp::FromNanoseconds(1).valid());
}

TEST(WatchdogTest, EachLimitIsExactToTheNanosecond) {
  Watchdog dog = Make();
  const test::NoAlloc guard;
  EXPECT_EQ(dog.Check(kWallClock, kSteady), Freshness::kNever);
  dog.Arrived(Stamp::FromNanoseconds(kWallClock), kSteady);
  EXPECT_EQ(dog.Check(kWallClock, kSteady), Freshness::kFresh);
  EXPECT_EQ(dog.Check(kWallClock + 50 * kMillisecond, kSteady), Freshness::kFresh);
  EXPECT_EQ(dog.Check(kWallClock + 50 * kMillisecond + 1, kSteady), Freshness::kOld);
  EXPECT_EQ(dog.Check(kWallClock - 10 * kMillisecond, kSteady), Freshness::kFresh);
  EXPECT_EQ(dog.Check(kWallClock - 10 * kMillisecond - 1, kSteady), Freshness::kAhead);
  EXPECT_EQ(dog.Check(kWallClock, kSteady + 40 * kMillisecond), Freshness::kFresh);
  EXPECT_EQ(dog.Check(kWallClock, kSteady + 40 * kMillisecond + 1), Freshness::kSilent);
}

TEST(WatchdogTest, StampZeroIsInvalid) {
  Watchdog dog = Make();
  dog.Arrived(Stamp{}, kSteady);
  EXPECT_EQ(dog.Check(kWallClock, kSteady), Freshness::kInvalidStamp);
  dog.Arrived(Stamp::FromNanoseconds(kWallClock), kSteady);
  EXPECT_EQ(dog.Check(kWallClock, kSteady), Freshness::kFresh);
}

// An administrator sets the system's clock back while the publisher is dead.
TEST(WatchdogTest, ClockJumpDoesNotHideSilence) {
  Watchdog dog = Make();
  dog.Arrived(Stamp::FromNanoseconds(kWallClock), kSteady);
  EXPECT_EQ(dog.Check(kWallClock - 3'600'000 * kMillisecond, kSteady + 100 * kMillisecond),
            Freshness::kSilent);
}

TEST(WatchdogTest, LimitsOutOfRangeAreRefused) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THROW(Watchdog({.max_age_s = 0.0}), std::invalid_argument);
  EXPECT_THROW(Watchdog({.max_silence_s = -1.0}), std::invalid_argument);
  EXPECT_THROW(Watchdog({.max_ahead_s = -1e-3}), std::invalid_argument);
  EXPECT_THROW(Watchdog({.max_age_s = nan}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::dds
