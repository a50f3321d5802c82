#include "dfr/hardware/sprk_driver.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/hardware_stewart/sprk_emulator.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::hardware {
namespace {

using kinematics::PlatformPose;
using testing::HasSubstr;

constexpr double kDegree = 0.017453292519943295;

PlatformPose Pose(double x, double y, double z, double yaw = 0.0) {
  PlatformPose pose;
  pose.translation_m << x, y, z;
  pose.angles_rad.z() = yaw;
  return pose;
}

// A driver at an emulated platform, on a clock that the test advances.
class SprkDriverTest : public testing::Test {
 protected:
  [[nodiscard]] SprkOptions Options() {
    return {.device = emulator_.device(),
            .clock_s = [this] { return now_s_; },
            .wait_s = [this](double seconds) { waits_s_.push_back(seconds), Wait(seconds); }};
  }
  void Wait(double seconds) { now_s_ += seconds; }

  test::SprkEmulator emulator_;
  double now_s_ = 1000.0;
  std::vector<double> waits_s_;
};

TEST_F(SprkDriverTest, EveryFrameArrivesInOnePiece) {
  SprkDriver driver(Options());
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  for (int i = 0; i < 300; ++i) {
    Wait(0.006);
    const double angle = 0.1 * i;
    ASSERT_EQ(driver.MoveTo(Pose(0.005 * std::cos(angle), 0.005 * std::sin(angle), 0.0, 0.1)),
              SprkStatus::kOk);
  }
  const auto commands = emulator_.Await(301);
  ASSERT_EQ(commands.size(), 301U);
  EXPECT_EQ(commands[0].letter, 'h');
  for (std::size_t i = 1; i < commands.size(); ++i) {
    ASSERT_EQ(commands[i].letter, 'a');
    ASSERT_TRUE(commands[i].whole);
    ASSERT_FALSE(commands[i].saturated);
  }
  const PlatformPose last = commands.back().Pose();
  // half a step of the protocol
  EXPECT_NEAR(last.translation_m.x(), 0.005 * std::cos(29.9), 0.000128);
  EXPECT_NEAR(last.translation_m.y(), 0.005 * std::sin(29.9), 0.000128);
  EXPECT_NEAR(last.angles_rad.z(), 0.1, 0.5001 * kDegree);
}

TEST_F(SprkDriverTest, NothingMovesBeforeHoming) {
  SprkDriver driver(Options());
  EXPECT_EQ(driver.MoveTo(Pose(0.001, 0, 0)), SprkStatus::kNotHomed);
  EXPECT_EQ(driver.Start(SprkWaveKind::kSine, {}), SprkStatus::kNotHomed);
  EXPECT_EQ(driver.Hold(), SprkStatus::kNotHomed);
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  const auto commands = emulator_.Await(1);
  ASSERT_EQ(commands.size(), 1U);
  EXPECT_EQ(commands[0].letter, 'h');
}

TEST_F(SprkDriverTest, RefusedPosesAreNotSent) {
  SprkDriver driver(Options());
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  Wait(1.0);
  EXPECT_EQ(driver.MoveTo(Pose(0.0127, 0, 0)), SprkStatus::kOutOfRange);
  EXPECT_EQ(driver.MoveTo(Pose(0, 0, 0.012)), SprkStatus::kOutOfReach);
  EXPECT_EQ(driver.MoveTo(Pose(NAN, 0, 0)), SprkStatus::kInvalid);
  ASSERT_EQ(driver.MoveTo(Pose(0.00508, 0, 0)), SprkStatus::kOk);
  Wait(0.0049);
  EXPECT_EQ(driver.MoveTo(Pose(0, 0, 0)), SprkStatus::kTooSoon);
  Wait(0.0002);
  EXPECT_EQ(driver.MoveTo(Pose(0, 0, 0)), SprkStatus::kOk);
  EXPECT_EQ(emulator_.Await(3).size(), 3U);
}

// The platform follows a command with a lag of 0.2 s.
TEST_F(SprkDriverTest, HoldStopsWhereThePlatformIs) {
  SprkDriver driver(Options());
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  Wait(SprkDriver::kHomeTime);
  ASSERT_EQ(driver.MoveTo(Pose(0.00762, -0.00508, 0, 5 * kDegree)), SprkStatus::kOk);
  Wait(0.1);
  ASSERT_EQ(driver.Hold(), SprkStatus::kOk);
  Wait(5.0);
  const auto commands = emulator_.Await(3);
  ASSERT_EQ(commands.size(), 3U);
  EXPECT_FALSE(commands[2].saturated);
  const double share = 1.0 - std::exp(-0.5);
  const PlatformPose there = commands[2].Pose();
  // half a step of the protocol
  EXPECT_NEAR(there.translation_m.x(), share * 0.00762, 0.000128);
  EXPECT_NEAR(there.translation_m.y(), share * -0.00508, 0.000128);
  EXPECT_NEAR(there.angles_rad.z(), share * 5 * kDegree, 0.5001 * kDegree);
  EXPECT_EQ(driver.Hold(), SprkStatus::kOk);  // any number of times
}

// The platform's position on the way is unknown, so Hold() can only repeat the goal.
TEST_F(SprkDriverTest, HoldReportsThatItCannotStopTheFirstWayHome) {
  SprkDriver driver(Options());
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  for (int n = 0; n < 2; ++n) {
    Wait(0.4 * SprkDriver::kHomeTime);
    EXPECT_EQ(driver.Hold(), SprkStatus::kGoesHome);
  }
  Wait(0.3 * SprkDriver::kHomeTime);
  EXPECT_EQ(driver.Hold(), SprkStatus::kOk);
  // The path of a later Home() is known.
  ASSERT_EQ((Wait(0.1), driver.MoveTo(Pose(0.00762, 0, 0))), SprkStatus::kOk);
  Wait(1.0);
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  Wait(0.1);
  EXPECT_EQ(driver.Hold(), SprkStatus::kOk);
  const auto commands = emulator_.Await(7);
  ASSERT_EQ(commands.size(), 7U);
  for (std::size_t i = 1; i < 4; ++i) {
    EXPECT_EQ(commands[i].letter, 'a');
    EXPECT_TRUE(commands[i].Pose().translation_m.isZero(1e-12));
  }
  EXPECT_NEAR(commands[6].Pose().translation_m.x(), 0.00762 * std::exp(-0.5), 0.000128);
}

TEST_F(SprkDriverTest, WavesHoldInTheirMiddle) {
  SprkDriver driver(Options());
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  Wait(1.0);
  SprkWave wave;
  wave.amplitude = Pose(0.00254, 0, 0, 4 * kDegree);
  wave.amplitude.angles_rad.y() = -3 * kDegree;
  wave.frequency_hz[0] = wave.frequency_hz[4] = wave.frequency_hz[5] = 0.1;
  ASSERT_EQ(driver.Start(SprkWaveKind::kBreath, wave), SprkStatus::kOk);
  Wait(20.0);
  ASSERT_EQ(driver.Hold(), SprkStatus::kOk);
  const auto commands = emulator_.Await(3);
  ASSERT_EQ(commands.size(), 3U);
  EXPECT_EQ(commands[1].letter, 'd');
  EXPECT_NEAR(commands[2].Pose().translation_m.x(), 0.00254, 1e-12);
  EXPECT_TRUE(commands[2].Pose().angles_rad.isZero(1e-12)) << "angles breathe about home";
}

// The driver ignores the firmware's output, and finds the fault with and without a command.
TEST_F(SprkDriverTest, PulledPlugIsReportedAndFinal) {
  for (const bool with_a_command : {false, true}) {
    test::SprkEmulator emulator;
    SprkDriver driver({.device = emulator.device(), .clock_s = [this] { return now_s_; }});
    EXPECT_EQ(driver.Check(), SprkStatus::kOk) << "the port is checked before homing, too";
    ASSERT_EQ(driver.Home(), SprkStatus::kOk);
    ASSERT_EQ(emulator.Await(1).size(), 1U);
    emulator.Print("nonsense \xff\x00");
    EXPECT_EQ(driver.Check(), SprkStatus::kOk);
    Wait(1.0);
    emulator.Unplug();
    EXPECT_EQ(with_a_command ? driver.MoveTo(Pose(0.001, 0, 0)) : driver.Check(),
              SprkStatus::kDeviceFailed);
    EXPECT_EQ(driver.Home(), SprkStatus::kDeviceFailed);
    EXPECT_EQ(driver.Hold(), SprkStatus::kDeviceFailed);
  }
}

// The other end of the port does not read: a frame beyond the buffer fails instead of waiting.
TEST_F(SprkDriverTest, FullPortFailsInsteadOfBlocking) {
  const int master = ::posix_openpt(O_RDWR | O_NOCTTY);
  ASSERT_GE(master, 0);
  ASSERT_EQ(::grantpt(master), 0);
  ASSERT_EQ(::unlockpt(master), 0);
  SprkDriver driver(
      {.device = ::ptsname(master), .clock_s = [this] { return now_s_; }, .wait_s = {}});
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  SprkStatus status = SprkStatus::kOk;
  for (int i = 0; i < 100000 && status == SprkStatus::kOk; ++i) {
    Wait(1.0);
    status = driver.MoveTo({});
  }
  EXPECT_EQ(status, SprkStatus::kDeviceFailed);
  ::close(master);
}

TEST_F(SprkDriverTest, CommandsDoNotAllocate) {
  SprkOptions options = Options();
  options.wait_s = [this](double seconds) { Wait(seconds); };
  SprkDriver driver(options);
  const test::NoAlloc guard;
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  Wait(1.0);
  EXPECT_EQ(driver.MoveTo(Pose(0.001, 0, 0)), SprkStatus::kOk);
  Wait(1.0);
  EXPECT_EQ(driver.Start(SprkWaveKind::kSine, {}), SprkStatus::kOk);
  Wait(1.0);
  EXPECT_EQ(driver.Hold(), SprkStatus::kOk);
  EXPECT_EQ(driver.Hold(), SprkStatus::kOk);  // this call waits
}

std::string OpenError(const std::string& device) {
  return dfr::test::MessageOf<std::runtime_error>(
      [&] { const SprkDriver driver({.device = device, .clock_s = {}}); });
}

TEST_F(SprkDriverTest, ErrorsOfOpeningNameTheReason) {
  EXPECT_THAT(OpenError("/dev/no-such-port"),
              testing::AllOf(HasSubstr("/dev/no-such-port"), HasSubstr("plugged in")));
  EXPECT_THAT(OpenError("/dev/null"), HasSubstr("not a serial port"));
  {
    const SprkDriver first(Options());
    EXPECT_THAT(OpenError(emulator_.device()), HasSubstr("another program"));
  }
  EXPECT_EQ(OpenError(emulator_.device()), "nothing thrown") << "it was closed";
}

// Directly after another frame, Hold() and Home() wait until the firmware can receive their frames.
TEST_F(SprkDriverTest, HoldAndHomeWaitForTheFirmware) {
  SprkDriver driver(Options());
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  EXPECT_TRUE(waits_s_.empty());
  Wait(0.002);
  ASSERT_EQ(driver.Hold(), SprkStatus::kGoesHome);
  ASSERT_EQ(driver.Home(), SprkStatus::kOk);
  Wait(2 * kSprkFramePeriod);
  ASSERT_EQ(driver.Hold(), SprkStatus::kGoesHome);
  ASSERT_EQ(waits_s_.size(), 2U);
  EXPECT_NEAR(waits_s_[0], kSprkFramePeriod - 0.002, 1e-9);
  EXPECT_NEAR(waits_s_[1], kSprkFramePeriod, 1e-9);
  EXPECT_EQ(emulator_.Await(4).size(), 4U);
}

}  // namespace
}  // namespace dfr::hardware
