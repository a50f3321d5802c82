#include "dfr/hardware/sprk_protocol.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>
#include <string_view>

#include "dfr/core/random.h"
#include "tests/hardware_stewart/sprk_firmware.h"
#include "tests/support/all_close.h"

namespace dfr::hardware {
namespace {

using kinematics::PlatformPose;

constexpr double kInch = 0.0254;
constexpr double kDegree = 0.017453292519943295;

PlatformPose Along(int entry, double value) {
  PlatformPose pose;
  (entry < 3 ? pose.translation_m[entry] : pose.angles_rad[entry - 3]) = value;
  return pose;
}

template <typename Frame>
std::string Text(const Frame& frame) {
  return {frame.begin(), frame.end()};
}

test::SprkFirmware::Command Decoded(std::string_view bytes) {
  test::SprkFirmware firmware;
  firmware.Receive(bytes);
  return firmware.commands().empty() ? test::SprkFirmware::Command{} : firmware.commands().back();
}

// The expected frames are encoded by hand from the protocol's description.
TEST(SprkProtocolTest, FramesMatchTheDescription) {
  SprkPositionFrame frame;
  PlatformPose sent;
  ASSERT_EQ(EncodeSprkPosition({}, frame, sent), SprkStatus::kOk);
  EXPECT_EQ(Text(frame), "a050505515151");
  // x +0.12 inch: 62, so "26". y -0.3: 20, "02". Roll 3 degrees: 18, "81". Yaw 2 degrees
  // right-handed are -2 for the firmware: 13, "31".
  PlatformPose pose;
  pose.translation_m << 0.12 * kInch, -0.3 * kInch, 0.0;
  pose.angles_rad << 3 * kDegree, 0.0, 2 * kDegree;
  ASSERT_EQ(EncodeSprkPosition(pose, frame, sent), SprkStatus::kOk);
  EXPECT_EQ(Text(frame), "a260205815131");

  SprkWaveFrame wave_frame;
  SprkWave wave_sent;
  SprkWave wave;
  wave.amplitude = Along(0, 0.1 * kInch);
  wave.frequency_hz[0] = 0.25;
  ASSERT_EQ(EncodeSprkWave(SprkWaveKind::kSine, wave, wave_frame, wave_sent), SprkStatus::kOk);
  EXPECT_EQ(Text(wave_frame), "c065205000500510051005100");
  // 0.1 Hz are 0.63 rad/s.
  wave.frequency_hz[0] = 0.1;
  ASSERT_EQ(EncodeSprkWave(SprkWaveKind::kBreath, wave, wave_frame, wave_sent), SprkStatus::kOk);
  EXPECT_EQ(Text(wave_frame), "d063605000500510051005100");
}

// The firmware decodes the values that the function returns, which are nearest to the requested
// values. The function accepts no pose at which the firmware would saturate.
TEST(SprkProtocolTest, FirmwareDecodesSentPoses) {
  core::Random random(1);
  int accepted = 0;
  int out_of_reach = 0;
  for (int trial = 0; trial < 4000; ++trial) {
    PlatformPose pose;
    for (int k = 0; k < 3; ++k) {
      pose.translation_m[k] = random.Uniform(-0.6, 0.6) * kInch;
      pose.angles_rad[k] = random.Uniform(-10.0, 10.0) * kDegree;
    }
    SprkPositionFrame frame;
    PlatformPose sent;
    const SprkStatus status = EncodeSprkPosition(pose, frame, sent);
    out_of_reach += status == SprkStatus::kOutOfReach;
    if (status != SprkStatus::kOk) continue;
    ++accepted;
    const auto command = Decoded(Text(frame));
    ASSERT_TRUE(command.whole);
    ASSERT_FALSE(command.saturated);
    // Inches and degrees in binary differ by a few units in the last place.
    ASSERT_TRUE(test::AllClose(command.Pose().translation_m, sent.translation_m, 1e-16));
    ASSERT_TRUE(test::AllClose(command.Pose().angles_rad, sent.angles_rad, 1e-15));
    // Rounding changes an entry by at most half a step.
    ASSERT_TRUE(test::AllClose(sent.translation_m, pose.translation_m, 0.0050001 * kInch));
    ASSERT_TRUE(test::AllClose(sent.angles_rad, pose.angles_rad, 0.50001 * kDegree));
  }
  EXPECT_GT(accepted, 200);
  EXPECT_GT(out_of_reach, 200);
}

// The firmware reads +0.50 inch as -0.50: a jump of an inch.
TEST(SprkProtocolTest, RangeIsRefusedBeforeItWrapsAround) {
  EXPECT_NEAR(Decoded("a000505515151").Pose().translation_m.x(), -0.5 * kInch, 1e-12);
  SprkPositionFrame frame;
  PlatformPose sent;
  for (int entry = 0; entry < 3; ++entry) {
    SCOPED_TRACE(entry);
    EXPECT_EQ(EncodeSprkPosition(Along(entry, 0.50 * kInch), frame, sent), SprkStatus::kOutOfRange);
    // Rounds to 0.50.
    EXPECT_EQ(EncodeSprkPosition(Along(entry, 0.4951 * kInch), frame, sent),
              SprkStatus::kOutOfRange);
    EXPECT_EQ(EncodeSprkPosition(Along(entry, -0.51 * kInch), frame, sent),
              SprkStatus::kOutOfRange);
    EXPECT_EQ(EncodeSprkPosition(Along(entry, 1e300), frame, sent), SprkStatus::kOutOfRange);
  }
  EXPECT_EQ(EncodeSprkPosition(Along(0, 0.49 * kInch), frame, sent), SprkStatus::kOk);
  EXPECT_EQ(EncodeSprkPosition(Along(5, 16 * kDegree), frame, sent), SprkStatus::kOutOfRange);
  EXPECT_EQ(EncodeSprkPosition(Along(5, 15 * kDegree), frame, sent), SprkStatus::kOk);

  SprkWave wave;
  SprkWaveFrame wave_frame;
  SprkWave wave_sent;
  const auto sine = [&](double frequency_hz) {
    wave.frequency_hz[1] = frequency_hz;
    return EncodeSprkWave(SprkWaveKind::kSine, wave, wave_frame, wave_sent);
  };
  EXPECT_EQ(sine(0.99), SprkStatus::kOk);
  EXPECT_EQ(sine(1.0), SprkStatus::kOutOfRange);  // would become 0.00
  EXPECT_EQ(sine(-0.1), SprkStatus::kOutOfRange);
  wave.frequency_hz[1] = 0.16;  // 1.005 rad/s
  EXPECT_EQ(EncodeSprkWave(SprkWaveKind::kBreath, wave, wave_frame, wave_sent),
            SprkStatus::kOutOfRange);
}

TEST(SprkProtocolTest, PublishedFifteenDegreesAreOutOfReach) {
  SprkPositionFrame frame;
  PlatformPose sent;
  EXPECT_TRUE(Decoded("a050505035151").saturated);  // roll +15: the firmware reports nothing
  EXPECT_EQ(EncodeSprkPosition(Along(3, 15 * kDegree), frame, sent), SprkStatus::kOutOfReach);
  EXPECT_EQ(EncodeSprkPosition(Along(4, -15 * kDegree), frame, sent), SprkStatus::kOutOfReach);
  EXPECT_EQ(EncodeSprkPosition(Along(2, 0.4 * kInch), frame, sent), SprkStatus::kOutOfReach);
}

TEST(SprkProtocolTest, BrokenNumbersAreRefused) {
  SprkPositionFrame frame;
  PlatformPose sent;
  SprkWaveFrame wave_frame;
  SprkWave wave_sent;
  for (const double broken :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    for (int entry = 0; entry < 6; ++entry) {
      EXPECT_EQ(EncodeSprkPosition(Along(entry, broken), frame, sent), SprkStatus::kInvalid);
      SprkWave wave;
      wave.frequency_hz[entry] = broken;
      EXPECT_EQ(EncodeSprkWave(SprkWaveKind::kSine, wave, wave_frame, wave_sent),
                SprkStatus::kInvalid);
    }
  }
}

// The breath moves positions to one side of home, and angles to both sides.
TEST(SprkProtocolTest, BreathsAreCheckedOverTheirWholeRange) {
  SprkWaveFrame frame;
  SprkWave sent;
  const auto breath = [&](int entry, double amplitude) {
    SprkWave wave;
    (entry < 3 ? wave.amplitude.translation_m[entry] : wave.amplitude.angles_rad[entry - 3]) =
        amplitude;
    return EncodeSprkWave(SprkWaveKind::kBreath, wave, frame, sent);
  };
  EXPECT_EQ(breath(2, 0.0041), SprkStatus::kOk) << "8.3 mm up";
  EXPECT_EQ(breath(2, 0.0046), SprkStatus::kOutOfReach);
  EXPECT_EQ(breath(4, 6 * kDegree), SprkStatus::kOk) << "6.1 degrees to both sides";
  EXPECT_EQ(breath(3, 6 * kDegree), SprkStatus::kOk) << "8.3 and -6.1 degrees";
  EXPECT_EQ(breath(3, 7 * kDegree), SprkStatus::kOutOfReach);
  EXPECT_EQ(breath(3, -7 * kDegree), SprkStatus::kOutOfReach);
}

// In 100 s, an accepted wave never saturates in the firmware. It has the requested frequency,
// although the firmware's unit is Hz for sines and rad/s for breaths.
TEST(SprkProtocolTest, WavesStayWithinReach) {
  core::Random random(2);
  int accepted = 0;
  int out_of_reach = 0;
  for (int trial = 0; trial < 120; ++trial) {
    const auto kind = trial % 2 == 0 ? SprkWaveKind::kSine : SprkWaveKind::kBreath;
    SprkWave wave;
    for (int k = 0; k < 6; ++k) {
      if (random.Uniform() < 0.5) continue;
      wave.frequency_hz[k] = random.Uniform(0.0, 0.15);
      const double size = random.Uniform(-1.0, 1.0);
      (k < 3 ? wave.amplitude.translation_m[k] : wave.amplitude.angles_rad[k - 3]) =
          k < 3 ? 0.3 * size * kInch : 4.0 * size * kDegree;
    }
    SprkWaveFrame frame;
    SprkWave sent;
    const SprkStatus status = EncodeSprkWave(kind, wave, frame, sent);
    out_of_reach += status == SprkStatus::kOutOfReach;
    if (status != SprkStatus::kOk) continue;
    ++accepted;
    const auto command = Decoded(Text(frame));
    EXPECT_FALSE(command.saturated) << "trial " << trial;
    EXPECT_TRUE(test::AllClose(command.Pose().translation_m, sent.amplitude.translation_m, 1e-16));
    EXPECT_TRUE(test::AllClose(command.Pose().angles_rad, sent.amplitude.angles_rad, 1e-15));
    // half a step: 0.005 Hz or rad/s
    const double half = kind == SprkWaveKind::kSine ? 0.0050001 : 0.0050001 / (2 * M_PI);
    EXPECT_TRUE(test::AllClose(sent.frequency_hz, wave.frequency_hz, half));
    EXPECT_TRUE(test::AllClose(command.rad_per_s, 2 * M_PI * sent.frequency_hz, 1e-14));
  }
  EXPECT_GT(accepted, 20);
  EXPECT_GT(out_of_reach, 20);
}

}  // namespace
}  // namespace dfr::hardware
