// The platform of a run, on an emulator's port.
#include "dfr/hardware/platform_motion.h"

#include <gtest/gtest.h>

#include "tests/hardware_stewart/sprk_emulator.h"
#include "tests/support/eventually.h"

namespace dfr::hardware {
namespace {

using runtime::HoldReason;

// The tests of a whole run cover rests and waves.
TEST(PlatformMotionTest, AFailedPortIsALastingFault) {
  test::SprkEmulator port;
  PlatformOptions options;
  options.device = port.device();
  options.wave = SprkWaveKind::kSine;
  options.motion.amplitude.translation_m.x() = 0.00254;
  options.motion.frequency_hz[0] = 0.1;
  PlatformMotion platform(options);
  ASSERT_TRUE(platform.Home().ok());
  test::Eventually([&] { return platform.Begin().ok(); });
  EXPECT_TRUE(platform.Check().ok());
  port.Unplug();
  for (int n = 0; n < 2; ++n) {
    for (const robot::Finding& found :
         {platform.Check(), platform.Rest(), platform.Home(), platform.Begin()}) {
      EXPECT_EQ(found.reason, HoldReason::kPlatform);
      EXPECT_EQ(found.detail, "its port failed: cut its power, then start again");
    }
  }
}

}  // namespace
}  // namespace dfr::hardware
