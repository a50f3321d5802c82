// The arm of a control loop, behind a simulated console.
#include "dfr/hardware/psm_arm.h"

#include <gtest/gtest.h>

#include <string_view>

#include "tests/hardware_dvrk/psm_driver_fixture.h"

namespace dfr::hardware {
namespace {

using PsmArmTest = PsmDriverTest;

TEST_F(PsmArmTest, AnArmThatIsSwitchedOffWhileItHomesIsAReasonToHold) {
  const auto driver = Connected();
  PsmArm arm(*driver, [](const auto&, const auto&) { return std::string_view(); });
  ASSERT_TRUE(arm.Home().ok());
  Until(*driver,
        [&] { return driver->client().operating_state().state == PsmConsoleState::kEnabled; });
  ASSERT_TRUE(arm.homing());
  console_.StateCommand("disable");
  robot::Finding found;
  test::Eventually([&] {
    server_.Publish(0.0, true);
    driver->Flush();
    found = arm.Tick(now_ns_, wall_ns());
    return !arm.homing();
  });
  EXPECT_EQ(found.reason, runtime::HoldReason::kArmNotReady);
  EXPECT_EQ(found.detail, Name(PsmStatus::kDisabled));
  EXPECT_FALSE(arm.needs_homing()) << "homing has ended with a doubt";
  (void)arm.Tick(now_ns_, wall_ns());
  EXPECT_TRUE(arm.needs_homing());
}

}  // namespace
}  // namespace dfr::hardware
