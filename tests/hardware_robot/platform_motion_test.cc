// The platform of a run, on an emulator's port.
#include "dfr/hardware/platform_motion.h"

#include <gtest/gtest.h>

#include <cstddef>
#include <optional>
#include <string>

#include "tests/hardware_stewart/sprk_emulator.h"
#include "tests/support/eventually.h"

namespace dfr::hardware {
namespace {

using runtime::HoldReason;

class PlatformMotionTest : public testing::Test {
 protected:
  PlatformMotionTest() {
    PlatformOptions options;
    options.device = port_.device();
    options.wave = SprkWaveKind::kSine;
    options.motion.amplitude.translation_m.x() = 0.00254;
    options.motion.frequency_hz[0] = 0.1;
    platform_.emplace(options);
  }
  // Begins when the previous frame has ended.
  void Begin() {
    test::Eventually([this] { return platform_->Begin().ok(); });
  }
  // Returns the letters of the first `count` commands.
  [[nodiscard]] std::string Arrived(std::size_t count) {
    std::string letters;
    for (const auto& command : port_.Await(count)) letters += command.letter;
    return letters;
  }

  test::SprkEmulator port_;
  std::optional<PlatformMotion> platform_;
};

TEST_F(PlatformMotionTest, RestsOnceAndAtItsEnd) {
  EXPECT_TRUE(platform_->Rest().ok());
  EXPECT_TRUE(platform_->Home().ok());
  EXPECT_TRUE(platform_->Rest().ok());
  Begin();
  EXPECT_TRUE(platform_->Rest().ok());
  EXPECT_TRUE(platform_->Rest().ok());
  EXPECT_EQ(Arrived(4), "haca") << "it rests only where it has moved";
  EXPECT_EQ(port_.Await(4).back().Pose().translation_m.x(), 0.0) << "the middle of the wave";
  Begin();
  platform_.reset();
  EXPECT_EQ(Arrived(6), "hacaca") << "the program ended in the middle of a wave";
}

TEST_F(PlatformMotionTest, AFailedPortIsALastingFault) {
  ASSERT_TRUE(platform_->Home().ok());
  Begin();
  EXPECT_TRUE(platform_->Check().ok());
  port_.Unplug();
  for (int n = 0; n < 2; ++n) {
    for (const robot::Finding& found :
         {platform_->Check(), platform_->Rest(), platform_->Home(), platform_->Begin()}) {
      EXPECT_EQ(found.reason, HoldReason::kPlatform);
      EXPECT_EQ(found.detail, "its port failed: cut its power, then start again");
    }
  }
}

}  // namespace
}  // namespace dfr::hardware
