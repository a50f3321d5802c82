#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <functional>
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

  // Number of periods from begin() to the one that must hold: the first one after the deadline.
  [[nodiscard]] int periods() const { return static_cast<int>(deadline_ns / kPeriodNs) + 1; }
};

inline std::vector<Source> Sources() {
  std::vector<Source> all;
  for (const runtime::HoldReason reason :
       {runtime::HoldReason::kArmSilent, runtime::HoldReason::kArmInvalid,
        runtime::HoldReason::kArmOld, runtime::HoldReason::kArmJump,
        runtime::HoldReason::kArmNotReady, runtime::HoldReason::kArmNotFollowing,
        runtime::HoldReason::kSecondCommander, runtime::HoldReason::kClock,
        runtime::HoldReason::kOverrun}) {
    all.push_back({"arm", reason,
                   [=](FakeRobot& r) {
                     r.arm.found = {reason, "the arm says so"};
                   },
                   [](FakeRobot& r) { r.arm.found = {}; }});
  }
  for (const runtime::HoldReason reason :
       {runtime::HoldReason::kImageSilent, runtime::HoldReason::kImageOld,
        runtime::HoldReason::kImageInvalid, runtime::HoldReason::kClock}) {
    all.push_back({"camera", reason,
                   [=](FakeRobot& r) {
                     r.camera.found = {reason, "it says"};
                   },
                   [](FakeRobot& r) { r.camera.found = {}; }});
  }
  for (const runtime::HoldReason reason :
       {runtime::HoldReason::kEmergencyStop, runtime::HoldReason::kEmergencyStopSilent}) {
    all.push_back({"stop", reason,
                   [=](FakeRobot& r) {
                     r.stop.found = {reason, "it says"};
                   },
                   [](FakeRobot& r) { r.stop.found = {}; }});
  }
  all.push_back({"camera's thread hangs", runtime::HoldReason::kImageSilent,
                 [](FakeRobot& r) { r.camera.hangs = true; },
                 [](FakeRobot& r) { r.camera.hangs = false; }, 250'000'000});
  all.push_back({"stop's thread hangs", runtime::HoldReason::kEmergencyStopSilent,
                 [](FakeRobot& r) { r.stop.hangs = true; },
                 [](FakeRobot& r) { r.stop.hangs = false; }, 100'000'000});
  all.push_back({"period", runtime::HoldReason::kOverrun,
                 [](FakeRobot& r) { r.clock.late_ns = 50'000'000 - kPeriodNs + 1; },
                 [](FakeRobot&) {}});
  all.push_back({"clock", runtime::HoldReason::kArmSilent,
                 [](FakeRobot& r) {
                   r.clock.found = {runtime::HoldReason::kArmSilent, "it stands"};
                 },
                 [](FakeRobot& r) { r.clock.found = {}; }});
  all.push_back({"recorder", runtime::HoldReason::kRecorder,
                 [](FakeRobot& r) { r.recorder.fails = true; },
                 [](FakeRobot& r) { r.recorder.fails = false; }});
  all.push_back({"platform", runtime::HoldReason::kPlatform,
                 [](FakeRobot& r) {
                   r.platform.found = {runtime::HoldReason::kPlatform, "it was unplugged"};
                 },
                 [](FakeRobot& r) { r.platform.found = {}; }});
  all.push_back({"operator", runtime::HoldReason::kOperator,
                 [](FakeRobot& r) { r.interrupted = true; },
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
  EXPECT_EQ(robot.loop.Apply(kControl), core::PlantStatus::kFault) << "nobody has started it";
  EXPECT_EQ(robot.arm.setpoints, setpoints) << "it moved";
  if (runtime::IsFault(reason)) {
    EXPECT_NE(robot.loop.Start(), runtime::HoldReason::kNone) << "a fault has to be cleared";
    EXPECT_TRUE(robot.loop.Clear());
  }
  EXPECT_EQ(robot.loop.Start(), runtime::HoldReason::kNone);
  EXPECT_EQ(robot.loop.Apply(kControl), core::PlantStatus::kOk);
}

}  // namespace dfr::test
