#include "dfr/hardware/sprk_protocol.h"

#include <cmath>

namespace dfr::hardware {
namespace {

using kinematics::PlatformPose;
using kinematics::SprkPlatform;

constexpr double kPi = 3.14159265358979323846;
constexpr double kInch = 0.0254;
constexpr double kDegree = kPi / 180.0;
constexpr int kLargestDegrees = 15;

double Entry(const PlatformPose& pose, int k) noexcept {
  return k < 3 ? pose.translation_m[k] : pose.angles_rad[k - 3];
}

double& Entry(PlatformPose& pose, int k) noexcept {
  return k < 3 ? pose.translation_m[k] : pose.angles_rad[k - 3];
}

// Returns one step of the protocol in our units and directions: pitch and yaw change their sign.
double Step(int k) noexcept {
  if (k < 3) return 0.01 * kInch;
  return k == 3 ? kDegree : -kDegree;
}

// Returns the firmware's number for zero steps from home.
int Zero(int k) noexcept { return k < 3 ? 50 : kLargestDegrees; }

bool Finite(const PlatformPose& pose) noexcept {
  return pose.translation_m.allFinite() && pose.angles_rad.allFinite();
}

void PutDigits(int number, char* at) noexcept {
  at[0] = static_cast<char>('0' + number % 10);
  at[1] = static_cast<char>('0' + number / 10);
}

// Encodes entry k as the firmware's number and writes its value to `sent`.
bool EncodeEntry(double value, int k, char* at, double& sent) noexcept {
  const double steps = std::round(value / Step(k));
  const int largest = k < 3 ? 49 : kLargestDegrees;
  const int smallest = k < 3 ? -50 : -kLargestDegrees;
  if (!(steps >= smallest && steps <= largest)) return false;
  PutDigits(static_cast<int>(steps) + Zero(k), at);
  sent = steps * Step(k) + 0.0;  // never -0
  return true;
}

bool EncodeFrequency(double per_second, char* at, double& sent) noexcept {
  const double steps = std::round(100.0 * per_second);
  if (!(steps >= 0.0 && steps <= 99.0)) return false;
  PutDigits(static_cast<int>(steps), at);
  sent = 0.01 * steps;
  return true;
}

// Returns true if the platform and its firmware reach the pose.
bool Reached(const PlatformPose& pose) noexcept {
  return SprkPlatform::Reachable(pose) && SprkPlatform::FirmwareReaches(pose);
}

bool LineReached(const PlatformPose& pose) noexcept {
  constexpr int kSteps = 32;  // several, because the reachable set is not always convex
  for (int i = 1; i <= kSteps; ++i) {
    const double share = static_cast<double>(i) / kSteps;
    if (!Reached({share * pose.translation_m, share * pose.angles_rad})) return false;
  }
  return true;
}

// Checks the straight lines to home from each of the 3^6 points with every entry at an end or the
// middle of its range. Omits repetitions of a point, which occur if a range is a single value.
bool BoxReachable(const PlatformPose& low, const PlatformPose& high) noexcept {
  for (int corner = 0; corner < 729; ++corner) {
    PlatformPose pose;
    bool repeated = false;
    for (int k = 0, rest = corner; k < 6; ++k, rest /= 3) {
      const double a = Entry(low, k);
      const double b = Entry(high, k);
      repeated = repeated || (a == b && rest % 3 != 0);
      Entry(pose, k) = a + 0.5 * (rest % 3) * (b - a);
    }
    if (!repeated && !LineReached(pose)) return false;
  }
  return true;
}

}  // namespace

const char* Name(SprkStatus status) noexcept {
  switch (status) {
    case SprkStatus::kOk:
      return "ok";
    case SprkStatus::kInvalid:
      return "not a finite number";
    case SprkStatus::kOutOfRange:
      return "beyond the range of the protocol";
    case SprkStatus::kOutOfReach:
      return "beyond the platform's reach";
    case SprkStatus::kNotHomed:
      return "not homed";
    case SprkStatus::kGoesHome:
      return "it goes home for the first time: only cutting its power stops it";
    case SprkStatus::kTooSoon:
      return "too soon after the last frame";
    case SprkStatus::kDeviceFailed:
      return "the device failed";
  }
  return "unknown";
}

SprkStatus EncodeSprkPosition(const PlatformPose& pose, SprkPositionFrame& frame,
                              PlatformPose& sent) noexcept {
  if (!Finite(pose)) return SprkStatus::kInvalid;
  frame[0] = 'a';
  PlatformPose rounded;
  for (int k = 0; k < 6; ++k) {
    char* at = frame.data() + 1 + 2 * k;
    if (!EncodeEntry(Entry(pose, k), k, at, Entry(rounded, k))) return SprkStatus::kOutOfRange;
  }
  if (!Reached(rounded)) return SprkStatus::kOutOfReach;
  sent = rounded;
  return SprkStatus::kOk;
}

PlatformPose SprkWaveMiddle(SprkWaveKind kind, const PlatformPose& amplitude) noexcept {
  PlatformPose middle;
  if (kind == SprkWaveKind::kBreath) middle.translation_m = amplitude.translation_m;
  return middle;
}

SprkStatus EncodeSprkWave(SprkWaveKind kind, const SprkWave& wave, SprkWaveFrame& frame,
                          SprkWave& sent) noexcept {
  if (!Finite(wave.amplitude) || !wave.frequency_hz.allFinite()) return SprkStatus::kInvalid;
  // The firmware multiplies the sine's frequency by 2 pi, but not the breath's.
  const double unit = kind == SprkWaveKind::kSine ? 1.0 : 2.0 * kPi;
  frame[0] = kind == SprkWaveKind::kSine ? 'c' : 'd';
  SprkWave rounded;
  PlatformPose low;
  PlatformPose high;
  for (int k = 0; k < 6; ++k) {
    char* at = frame.data() + 1 + 4 * k;
    double& amplitude = Entry(rounded.amplitude, k);
    double frequency = 0.0;
    if (!EncodeEntry(Entry(wave.amplitude, k), k, at, amplitude)) return SprkStatus::kOutOfRange;
    if (!EncodeFrequency(unit * wave.frequency_hz[k], at + 2, frequency)) {
      return SprkStatus::kOutOfRange;
    }
    rounded.frequency_hz[k] = frequency / unit;
    const double middle = Entry(SprkWaveMiddle(kind, rounded.amplitude), k);
    Entry(low, k) = middle - amplitude;
    Entry(high, k) = middle + amplitude;
  }
  if (!BoxReachable(low, high)) return SprkStatus::kOutOfReach;
  sent = rounded;
  return SprkStatus::kOk;
}

}  // namespace dfr::hardware
