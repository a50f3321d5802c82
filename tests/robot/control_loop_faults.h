#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <limits>
#include <string>
#include <vector>

#include "tests/robot/fake_robot.h"

namespace dfr::test {

inline constexpr std::array kControl = {0.3, 0.4};  // 0.5 mm in 5 periods
inline constexpr std::array kLong = {6.0, 8.0};     // 100 periods
inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

/// A fault during the loop: its beginning, its end, and the deadline of the hold.
struct Source {
  std::string name;
  runtime::HoldReason reason;
  std::function<void(FakeRobot&)> begin;
  std::function<void(FakeRobot&)> end;
  std::int64_t deadline_ns = 0;  // 0: none; the fault counts in the period in which it is found

  // Number of periods from begin() to the period that must hold, the first one after the deadline.
  [[nodiscard]] int periods() const { return static_cast<int>(deadline_ns / kPeriodNs) + 1; }
};

inline std::vector<Source> Sources() {
  using runtime::HoldReason;
  std::vector<Source> all;
  // Adds a fault per reason: `device` reports the reason.
  const auto add = [&all](const char* name, auto device,
                          std::initializer_list<HoldReason> reasons) {
    for (const HoldReason reason : reasons) {
      all.push_back({name, reason,
                     [=](FakeRobot& r) {
                       (r.*device).found = {reason, "it says"};
                     },
                     [=](FakeRobot& r) { (r.*device).found = {}; }});
    }
  };
  add("arm", &FakeRobot::arm,
      {HoldReason::kArmSilent, HoldReason::kArmInvalid, HoldReason::kArmOld, HoldReason::kArmJump,
       HoldReason::kArmNotReady, HoldReason::kArmNotFollowing, HoldReason::kSecondCommander,
       HoldReason::kClock, HoldReason::kOverrun});
  add("camera", &FakeRobot::camera,
      {HoldReason::kImageSilent, HoldReason::kImageOld, HoldReason::kImageInvalid,
       HoldReason::kClock});
  add("stop", &FakeRobot::stop, {HoldReason::kEmergencyStop, HoldReason::kEmergencyStopSilent});
  add("clock", &FakeRobot::clock, {HoldReason::kArmSilent});
  add("platform", &FakeRobot::platform, {HoldReason::kPlatform});
  all.push_back({"camera's thread hangs", HoldReason::kImageSilent,
                 [](FakeRobot& r) { r.camera.hangs = true; },
                 [](FakeRobot& r) { r.camera.hangs = false; }, 250'000'000});
  all.push_back({"stop's thread hangs", HoldReason::kEmergencyStopSilent,
                 [](FakeRobot& r) { r.stop.hangs = true; },
                 [](FakeRobot& r) { r.stop.hangs = false; }, 100'000'000});
  all.push_back({"period", HoldReason::kOverrun,
                 [](FakeRobot& r) { r.clock.late_ns = 50'000'000 - kPeriodNs + 1; },
                 [](FakeRobot&) {}});
  all.push_back({"recorder", HoldReason::kRecorder, [](FakeRobot& r) { r.recorder.fails = true; },
                 [](FakeRobot& r) { r.recorder.fails = false; }});
  all.push_back({"operator", HoldReason::kOperator, [](FakeRobot& r) { r.interrupted = true; },
                 [](FakeRobot& r) { r.interrupted = false; }});
  return all;
}

/// Checks that the robot holds for `reason` until the operator starts it again.
inline void ExpectHeldUntilStarted(FakeRobot& robot, runtime::HoldReason reason,
                                   const std::function<void()>& mend = {}) {
  EXPECT_EQ(robot.loop.state(),
            runtime::IsFault(reason) ? runtime::RunState::kFaulted : runtime::RunState::kHolding);
  EXPECT_FALSE(robot.loop.may_move());
  EXPECT_FALSE(robot.arm.armed());
  EXPECT_EQ(robot.recorder.last.reason, reason);
  EXPECT_THAT(robot.loop.cause(), testing::HasSubstr(runtime::Name(reason)));
  const int setpoints = robot.arm.setpoints;
  EXPECT_EQ(robot.loop.Apply(kControl), core::PlantStatus::kFault);
  if (mend) {
    EXPECT_NE(robot.loop.Start(), runtime::HoldReason::kNone) << "the reason lasts";
    EXPECT_FALSE(robot.loop.Clear());
    mend();
  }
  robot.loop.Idle(2.0);
  EXPECT_EQ(robot.loop.Apply(kControl), core::PlantStatus::kFault) << "it has not been started";
  EXPECT_EQ(robot.arm.setpoints, setpoints) << "it moved";
  if (runtime::IsFault(reason)) {
    EXPECT_NE(robot.loop.Start(), runtime::HoldReason::kNone) << "a fault has to be cleared";
    EXPECT_TRUE(robot.loop.Clear());
  }
  EXPECT_EQ(robot.loop.Start(), runtime::HoldReason::kNone);
  EXPECT_EQ(robot.loop.Apply(kControl), core::PlantStatus::kOk);
}

}  // namespace dfr::test
