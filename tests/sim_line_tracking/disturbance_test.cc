#include "dfr/sim/line_tracking/disturbance.h"

#include <gtest/gtest.h>

#include <cmath>
#include <stdexcept>

namespace dfr::sim {
namespace {

using kinematics::PlatformPose;
using kinematics::SprkPlatform;

double Entry(const PlatformPose& pose, int k) {
  return k < 3 ? pose.translation_m[k] : pose.angles_rad[k - 3];
}

DisturbanceOptions Options(Wave wave) {
  DisturbanceOptions options;
  options.wave = wave;
  options.amplitude = {0.003, 0.002, 0.001, 0.01, 0.02, 0.03};
  options.frequency = {0.5, 0.7, 0.9, 1.1, 1.3, 1.5};
  return options;
}

TEST(DisturbanceTest, AllWavesStartAtHome) {
  for (Wave wave : {Wave::kNone, Wave::kSine, Wave::kBreath, Wave::kRandom}) {
    const PlatformPose pose = Disturbance(Options(wave), 1).At(0.0);
    for (int k = 0; k < 6; ++k) EXPECT_NEAR(Entry(pose, k), 0.0, 1e-16) << Name(wave) << k;
  }
}

TEST(DisturbanceTest, SineMatchesTheFirmware) {
  const DisturbanceOptions options = Options(Wave::kSine);
  const PlatformPose pose = Disturbance(options, 1).At(0.3);
  for (std::size_t k = 0; k < 6; ++k) {
    EXPECT_DOUBLE_EQ(
        Entry(pose, static_cast<int>(k)),
        options.amplitude[k] * std::sin(6.283185307179586 * options.frequency[k] * 0.3));
  }
}

// The range is [0, 2 amplitude] for positions and [-amplitude, amplitude] for angles. The breath
// reaches both ends, and its frequency is in rad/s.
TEST(DisturbanceTest, BreathHasTheFirmwaresRangeAndPeriod) {
  const DisturbanceOptions options = Options(Wave::kBreath);
  const Disturbance breath(options, 1);
  for (int k = 0; k < 6; ++k) {
    const double a = options.amplitude[static_cast<std::size_t>(k)];
    const double period = 6.283185307179586 / options.frequency[static_cast<std::size_t>(k)];
    double lowest = 1.0;
    double highest = -1.0;
    for (int i = 0; i < 2000; ++i) {
      const double t = i * period / 2000;
      lowest = std::fmin(lowest, Entry(breath.At(t), k));
      highest = std::fmax(highest, Entry(breath.At(t), k));
    }
    EXPECT_NEAR(lowest, k < 3 ? 0.0 : -a, 1e-6 * a);  // sampled 2000 times per period
    EXPECT_NEAR(highest, k < 3 ? 2 * a : a, 1e-6 * a);
    EXPECT_NEAR(Entry(breath.At(period), k), Entry(breath.At(0.0), k), 1e-12);
  }
}

TEST(DisturbanceTest, RandomStaysWithinItsAmplitudeAndDependsOnTheSeed) {
  const DisturbanceOptions options = Options(Wave::kRandom);
  const Disturbance one(options, 1);
  const Disturbance same(options, 1);
  const Disturbance other(options, 2);
  double largest = 0.0;
  for (int i = 1; i < 1000; ++i) {
    const double t = 0.1 * i;
    for (int k = 0; k < 6; ++k) {
      const double a = options.amplitude[static_cast<std::size_t>(k)];
      EXPECT_LE(std::abs(Entry(one.At(t), k)), a);
      largest = std::fmax(largest, std::abs(Entry(one.At(t), k)) / a);
      EXPECT_EQ(Entry(one.At(t), k), Entry(same.At(t), k));
    }
    EXPECT_NE(Entry(one.At(t), 0), Entry(other.At(t), 0));
  }
  EXPECT_GT(largest, 0.7);
}

TEST(DisturbanceTest, RandomIsShortenedToThePlatformsReach) {
  DisturbanceOptions options = Options(Wave::kRandom);
  options.amplitude = {0.02, 0.02, 0.02, 0.1, 0.1, 0.1};
  const Disturbance wild(options, 1);
  for (int i = 0; i < 1000; ++i) {
    const double t = 0.1 * i;
    EXPECT_TRUE(SprkPlatform::Reachable(wild.At(t))) << t;
  }
}

TEST(DisturbanceTest, SineOrBreathBeyondReachThrows) {
  DisturbanceOptions tilted = Options(Wave::kSine);
  tilted.amplitude[4] = 0.26;  // the published 15 degrees
  DisturbanceOptions raised = Options(Wave::kBreath);
  raised.amplitude[2] = 0.005;  // 10 mm up; the reach ends at 8.3 mm
  DisturbanceOptions broken = Options(Wave::kSine);
  broken.frequency[0] = std::nan("");
  for (const DisturbanceOptions& options : {tilted, raised, broken}) {
    EXPECT_THROW(Disturbance(options, 1), std::invalid_argument);
  }
}

}  // namespace
}  // namespace dfr::sim
