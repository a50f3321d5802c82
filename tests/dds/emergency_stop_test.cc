#include "dfr/dds/emergency_stop.h"

#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <stdexcept>
#include <thread>
#include <vector>

#include "tests/dds/domain.h"

namespace dfr::dds {
namespace {

constexpr std::int64_t kMillisecond = 1'000'000;

class EmergencyStopTest : public testing::Test {
 protected:
  // Beats until the receiver says `wanted`, for a minute at most: a busy machine gets that.
  bool BeatsUntil(EmergencyStop wanted) {
    for (int i = 0; i < 12'000; ++i) {
      button_.Beat();
      if (receiver_.Check(now_ns_) == wanted) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    return false;
  }

  int domain_ = test::OwnDomain();
  Participant operator_{{.domain = domain_}};
  Participant robot_{{.domain = domain_}};
  EmergencyStopButton button_{operator_};
  EmergencyStopReceiver receiver_{robot_, 0.1};
  std::int64_t now_ns_ = 1000 * kMillisecond;
};

TEST_F(EmergencyStopTest, IsSilentUntilHeardAndWhenNoLongerHeard) {
  EXPECT_EQ(receiver_.Check(now_ns_), EmergencyStop::kSilent);
  ASSERT_TRUE(BeatsUntil(EmergencyStop::kClear));
  // What is still under way arrives.
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  EXPECT_EQ(receiver_.Check(now_ns_), EmergencyStop::kClear);
  EXPECT_EQ(receiver_.Check(now_ns_ + 100 * kMillisecond), EmergencyStop::kClear);
  EXPECT_EQ(receiver_.Check(now_ns_ + 101 * kMillisecond), EmergencyStop::kSilent);
  now_ns_ += 500 * kMillisecond;
  EXPECT_TRUE(BeatsUntil(EmergencyStop::kClear)) << "who comes back is heard again";
}

TEST_F(EmergencyStopTest, StaysPressedUntilReleasedAndAcknowledged) {
  ASSERT_TRUE(BeatsUntil(EmergencyStop::kClear));
  button_.Press();
  ASSERT_TRUE(BeatsUntil(EmergencyStop::kPressed));
  receiver_.Acknowledge();
  ASSERT_TRUE(BeatsUntil(EmergencyStop::kPressed)) << "it is still pressed";
  button_.Release();
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  EXPECT_EQ(receiver_.Check(now_ns_), EmergencyStop::kPressed) << "nobody has acknowledged it";
  receiver_.Acknowledge();
  EXPECT_TRUE(BeatsUntil(EmergencyStop::kClear));
}

TEST_F(EmergencyStopTest, APressIsNotForgottenByAReleaseRightAfter) {
  ASSERT_TRUE(BeatsUntil(EmergencyStop::kClear));
  button_.Press();
  button_.Release();
  EXPECT_TRUE(BeatsUntil(EmergencyStop::kPressed));
}

// Whoever joins late must not move before it knows.
TEST_F(EmergencyStopTest, LateJoinersLearnThatItIsPressed) {
  button_.Press();
  EmergencyStopReceiver late(robot_, 0.1);
  for (int i = 0; i < 12'000 && late.Check(now_ns_) != EmergencyStop::kPressed; ++i) {
    ASSERT_NE(late.Check(now_ns_), EmergencyStop::kClear);
    std::this_thread::sleep_for(std::chrono::milliseconds(5));  // without a further beat
  }
  EXPECT_EQ(late.Check(now_ns_), EmergencyStop::kPressed);
}

// A stop that was forgotten does not hide that the operator's has died.
TEST_F(EmergencyStopTest, EachButtonIsMissedByItself) {
  ASSERT_TRUE(BeatsUntil(EmergencyStop::kClear));
  {
    EmergencyStopButton operators(operator_);
    for (int i = 0; i < 12'000 && receiver_.num_buttons() < 2; ++i) {
      operators.Beat();
      ASSERT_TRUE(BeatsUntil(EmergencyStop::kClear));
    }
    ASSERT_EQ(receiver_.num_buttons(), 2);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  static_cast<void>(receiver_.Check(now_ns_));
  now_ns_ += 101 * kMillisecond;
  for (int i = 0; i < 20; ++i) {
    button_.Beat();
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    EXPECT_EQ(receiver_.Check(now_ns_), EmergencyStop::kSilent) << "the other one goes on";
  }
  receiver_.Acknowledge();
  EXPECT_EQ(receiver_.num_buttons(), 1);
  EXPECT_TRUE(BeatsUntil(EmergencyStop::kClear)) << "the operator knows that it is gone";
}

TEST_F(EmergencyStopTest, MoreButtonsThanItCanFollowAreNotTrusted) {
  std::vector<std::unique_ptr<EmergencyStopButton>> buttons;
  buttons.reserve(9);
  for (int i = 0; i < 9; ++i) buttons.push_back(std::make_unique<EmergencyStopButton>(operator_));
  EmergencyStop found = EmergencyStop::kSilent;
  for (int i = 0; i < 12'000 && receiver_.num_buttons() < 8; ++i) {
    for (const auto& button : buttons) button->Beat();
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    found = receiver_.Check(now_ns_);
  }
  for (int i = 0; i < 20; ++i) {
    for (const auto& button : buttons) button->Beat();
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    found = receiver_.Check(now_ns_);
  }
  EXPECT_EQ(found, EmergencyStop::kSilent);
}

TEST_F(EmergencyStopTest, ThrowsForATimeThatMakesNoSense) {
  EXPECT_THROW(EmergencyStopReceiver(robot_, 0.0), std::invalid_argument);
  EXPECT_THROW(EmergencyStopReceiver(robot_, 11.0), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::dds
