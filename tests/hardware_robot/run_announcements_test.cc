#include <gtest/gtest.h>

#include "dfr/hardware/emergency_stop_monitor.h"

namespace dfr::hardware {
namespace {

using runtime::RunState;

constexpr std::int64_t kMs = 1'000'000;

TEST(RunAnnouncementsTest, AChangeIsAnnouncedAtOnceAndARepeatFiftyTimesASecond) {
  RunAnnouncements announcements;
  EXPECT_TRUE(announcements.Due(RunState::kRunning, 1000 * kMs, 1000 * kMs));
  EXPECT_FALSE(announcements.Due(RunState::kRunning, 1019 * kMs, 1019 * kMs));
  EXPECT_TRUE(announcements.Due(RunState::kRunning, 1020 * kMs, 1020 * kMs));
  EXPECT_TRUE(announcements.Due(RunState::kHolding, 1021 * kMs, 1021 * kMs));
  EXPECT_FALSE(announcements.Due(RunState::kHolding, 1022 * kMs, 1022 * kMs));
}

TEST(RunAnnouncementsTest, AHangingLoopIsNotAnnounced) {
  RunAnnouncements announcements;
  EXPECT_FALSE(announcements.Due(RunState::kIdle, 0, 1000 * kMs)) << "it has not begun";
  EXPECT_TRUE(announcements.Due(RunState::kRunning, 1000 * kMs, 1100 * kMs));
  EXPECT_FALSE(announcements.Due(RunState::kRunning, 1000 * kMs, 1120 * kMs));
  EXPECT_FALSE(announcements.Due(RunState::kHolding, 1000 * kMs, 1120 * kMs));
  EXPECT_TRUE(announcements.Due(RunState::kHolding, 1125 * kMs, 1125 * kMs));
}

}  // namespace
}  // namespace dfr::hardware
