// Evaluation of the buttons' messages: any uncertainty stops the robot.
#include "dfr/dds/emergency_stop.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <stdexcept>

#include "tests/support/no_alloc.h"

namespace dfr::dds {
namespace {

using Way = EmergencyStopJudge::Way;

constexpr std::int64_t kMs = 1'000'000;
constexpr std::int64_t kStart = 1000 * kMs;
constexpr std::int64_t kSilence = 100 * kMs;

Origin Button(int number) {
  Origin who{};
  who[15] = static_cast<std::uint8_t>(number);
  return who;
}

class EmergencyStopJudgeTest : public testing::Test {
 protected:
  // A button sends its state on both paths.
  void Hear(int button, std::int64_t now_ns, bool pressed = false) {
    judge_.Hear(Way::kDds, Button(button), pressed, now_ns);
    judge_.Hear(Way::kDatagrams, Button(button), pressed, now_ns);
  }

  EmergencyStopJudge judge_{1e-9 * kSilence};
};

TEST_F(EmergencyStopJudgeTest, IsSilentUntilHeardAndWhenNoLongerHeard) {
  EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kSilent);
  Hear(1, kStart);
  EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kClear);
  EXPECT_EQ(judge_.Check(kStart + kSilence), EmergencyStop::kClear);
  EXPECT_EQ(judge_.Check(kStart + kSilence + 1), EmergencyStop::kSilent);
  Hear(1, kStart + 5 * kSilence);
  EXPECT_EQ(judge_.Check(kStart + 5 * kSilence), EmergencyStop::kClear) << "heard again";
}

TEST_F(EmergencyStopJudgeTest, NeitherWayAloneIsEnough) {
  judge_.Hear(Way::kDds, Button(1), false, kStart);
  EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kSilent);
  EXPECT_TRUE(judge_.only_datagrams_silent());
  judge_.Hear(Way::kDatagrams, Button(1), false, kStart);
  EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kClear);
  EXPECT_FALSE(judge_.only_datagrams_silent());
  const std::int64_t later_ns = kStart + kSilence + 1;
  judge_.Hear(Way::kDatagrams, Button(1), false, later_ns);
  EXPECT_EQ(judge_.Check(later_ns), EmergencyStop::kSilent);
  EXPECT_FALSE(judge_.only_datagrams_silent()) << "only DDS is silent";
  judge_.Hear(Way::kDds, Button(1), false, later_ns + kSilence + 1);
  EXPECT_EQ(judge_.Check(later_ns + kSilence + 1), EmergencyStop::kSilent);
  EXPECT_TRUE(judge_.only_datagrams_silent());
}

TEST_F(EmergencyStopJudgeTest, APressOnEitherWayStaysUntilReleasedAndAcknowledged) {
  for (const Way way : {Way::kDds, Way::kDatagrams}) {
    Hear(1, kStart);
    ASSERT_EQ(judge_.Check(kStart), EmergencyStop::kClear);
    judge_.Hear(way, Button(1), true, kStart);
    EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kPressed);
    judge_.Acknowledge();
    judge_.Hear(way, Button(1), true, kStart);
    EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kPressed) << "it is still pressed";
    Hear(1, kStart);
    EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kPressed) << "no operator has acknowledged it";
    EXPECT_EQ(judge_.Check(kStart + 2 * kSilence), EmergencyStop::kPressed) << "also silent";
    EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kPressed);
    judge_.Acknowledge();
    EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kClear);
  }
}

// A button that still sends does not hide the failure of another button.
TEST_F(EmergencyStopJudgeTest, TheSilenceOfEachButtonIsDetected) {
  Hear(1, kStart);
  Hear(2, kStart);
  ASSERT_EQ(judge_.Check(kStart), EmergencyStop::kClear);
  EXPECT_EQ(judge_.num_buttons(), 2);
  const std::int64_t later_ns = kStart + kSilence + 1;
  for (int beat = 0; beat < 20; ++beat) {
    Hear(1, later_ns + beat * 20 * kMs);
    EXPECT_EQ(judge_.Check(later_ns + beat * 20 * kMs), EmergencyStop::kSilent);
  }
  judge_.Acknowledge();
  EXPECT_EQ(judge_.num_buttons(), 1);
  EXPECT_EQ(judge_.Check(later_ns + 19 * 20 * kMs), EmergencyStop::kClear)
      << "the operator knows that it is gone";
}

// The two paths of one button do not hide the missing path of another button.
TEST_F(EmergencyStopJudgeTest, EachButtonNeedsBothWays) {
  for (const Way way : {Way::kDds, Way::kDatagrams}) {
    EmergencyStopJudge judge(1e-9 * kSilence);
    judge.Hear(way, Button(1), false, kStart);
    judge.Hear(Way::kDds, Button(2), false, kStart);
    judge.Hear(Way::kDatagrams, Button(2), false, kStart);
    EXPECT_EQ(judge.Check(kStart), EmergencyStop::kSilent);
    EXPECT_EQ(judge.only_datagrams_silent(), way == Way::kDds);
    judge.Acknowledge();
    EXPECT_EQ(judge.Check(kStart), EmergencyStop::kSilent) << "it is not repaired";
  }
  EmergencyStopJudge dds_alone(1e-9 * kSilence, false);
  dds_alone.Hear(Way::kDds, Button(1), false, kStart);
  dds_alone.Hear(Way::kDatagrams, Button(2), false, kStart);
  EXPECT_EQ(dds_alone.Check(kStart), EmergencyStop::kClear);
}

TEST_F(EmergencyStopJudgeTest, MoreButtonsThanItCanFollowAreNotTrusted) {
  const test::NoAlloc guard;
  for (int button = 1; button <= 8; ++button) Hear(button, kStart);
  ASSERT_EQ(judge_.Check(kStart), EmergencyStop::kClear);
  Hear(9, kStart);
  for (int button = 1; button <= 8; ++button) Hear(button, kStart);
  EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kSilent);
  EXPECT_EQ(judge_.num_buttons(), 8);
  Hear(9, kStart, true);
  EXPECT_EQ(judge_.Check(kStart), EmergencyStop::kPressed) << "it stops all the same";
}

TEST_F(EmergencyStopJudgeTest, RefusesAnAllowedSilenceOutOfRange) {
  EXPECT_THROW(EmergencyStopJudge(0.0), std::invalid_argument);
  EXPECT_THROW(EmergencyStopJudge(11.0), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::dds
