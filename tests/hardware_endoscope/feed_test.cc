// Expiry of pictures to the nanosecond, with a clock that the test sets.
#include "feed.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <utility>
#include <vector>

#include "tests/support/no_alloc.h"

namespace dfr::hardware::internal {
namespace {

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kWall = 1'700'000'000'000'000'000;
constexpr std::int64_t kSteady = 5'000 * kMs;
constexpr int kFeedWidth = 16;
constexpr int kFeedHeight = 8;

class FeedTest : public testing::Test {
 protected:
  static EndoscopeOptions Options() {
    EndoscopeOptions options;
    options.width = kFeedWidth;
    options.height = kFeedHeight;
    options.max_age_s = 0.1;
    options.max_ahead_s = 0.01;
    options.max_repeats = 3;
    return options;
  }
  void Put(std::uint8_t grey, std::int64_t stamp_ns = kWall, std::int64_t arrival_ns = kSteady) {
    const std::vector<std::uint8_t> pixels(std::size_t{kFeedWidth} * kFeedHeight, grey);
    feed_.Put(pixels.data(), kFeedWidth, kFeedHeight, kFeedWidth, 1, false, stamp_ns, arrival_ns);
  }
  FrameStatus Grab(std::int64_t steady_ns, std::int64_t wall_ns) {
    return feed_.Grab(steady_ns, wall_ns, frame_);
  }

  Feed feed_{Options()};
  Frame frame_;
};

TEST_F(FeedTest, IsSilentAfterTheLongestAgeWithoutAPicture) {
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kNever);
  Put(100);
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kOk);
  EXPECT_EQ(Grab(kSteady + 100 * kMs, kWall + 100 * kMs), FrameStatus::kOk);
  EXPECT_EQ(Grab(kSteady + 100 * kMs + 1, kWall + 100 * kMs + 1), FrameStatus::kSilent);
  EXPECT_EQ(Grab(kSteady + 100 * kMs + 1, kWall - 3'600'000 * kMs), FrameStatus::kSilent)
      << "a clock that is set back hides nothing";
}

TEST_F(FeedTest, IsOldWhenItArrivesLate) {
  Put(100, kWall - 100 * kMs);
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kOk);
  EXPECT_EQ(Grab(kSteady, kWall + 1), FrameStatus::kOld);
}

TEST_F(FeedTest, IsAheadWhenItsStampIs) {
  Put(100, kWall + 10 * kMs);
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kOk);
  EXPECT_EQ(Grab(kSteady, kWall - 1), FrameStatus::kAhead);
  Put(101, 0);
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kInvalidStamp);
}

TEST_F(FeedTest, IsFrozenAfterSeveralRepeatsAndDarkAtOnce) {
  for (int repeat = 1; repeat <= 4; ++repeat) {
    Put(100);
    EXPECT_EQ(Grab(kSteady, kWall), repeat < 3 ? FrameStatus::kOk : FrameStatus::kFrozen) << repeat;
  }
  Put(101);
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kOk);
  Put(24);
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kDark);
  Put(25);
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kOk);
}

TEST_F(FeedTest, GapsBetweenStampsCountAsLosses) {
  std::int64_t stamp_ns = kWall;
  for (const auto& [periods, lost] : {std::pair{1.0, 0U}, {1.4, 0U}, {4.0, 3U}, {-2.0, 3U}}) {
    Put(100, stamp_ns);
    stamp_ns += static_cast<std::int64_t>(periods * 1e9 / 30.0);
    Put(101, stamp_ns);
    EXPECT_EQ(feed_.counts().lost, lost) << periods;
  }
  EXPECT_EQ(feed_.counts().received, 8U);
}

TEST_F(FeedTest, GrabNeverAllocates) {
  for (int i = 0; i < 5; ++i) {
    Put(static_cast<std::uint8_t>(100 + i));
    const test::NoAlloc guard;
    EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kOk);
    EXPECT_EQ(Grab(kSteady, kWall + 3'600'000 * kMs), FrameStatus::kOld);
  }
}

TEST_F(FeedTest, EndsAfterItsLastPicture) {
  Put(100);
  feed_.End(FrameStatus::kFailed);
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kOk) << "the last picture was not grabbed yet";
  EXPECT_EQ(Grab(kSteady, kWall), FrameStatus::kFailed);
}

}  // namespace
}  // namespace dfr::hardware::internal
