#pragma once

#include <Eigen/Core>
#include <array>

#include "dfr/kinematics/sprk_platform.h"

namespace dfr::hardware {

/// Result of a command to the platform. Any value except kOk, kGoesHome and kDeviceFailed means
/// that nothing was sent and nothing moved. After kDeviceFailed the pose is unknown.
enum class SprkStatus {
  kOk,
  kInvalid,       ///< An entry is not finite.
  kOutOfRange,    ///< The value is not representable in two digits.
  kOutOfReach,    ///< The motion leaves the mechanism's reach, at the goal or on the way.
  kNotHomed,      ///< No successful Home() yet: the pose is unknown.
  kGoesHome,      ///< Hold() cannot stop the first Home(): only cutting the platform's power does.
  kTooSoon,       ///< Less than kSprkFramePeriod after the last frame.
  kDeviceFailed,  ///< Writing failed. Requires a new driver and homing.
};

[[nodiscard]] const char* Name(SprkStatus status) noexcept;

/// Minimum time between two frames, s: the firmware loses bytes of faster frames.
inline constexpr double kSprkFramePeriod = 0.005;

/// The published protocol: 57600 baud 8N1, ASCII, no acknowledgement, no checksum, no feedback.
///
///   h                  home
///   a + 12 digits      position: x, y, z, roll, pitch, yaw
///   c, d + 24 digits   sine, breath: amplitude and frequency of x, y, z, roll, pitch, yaw
/// Each value is an integer from 0 to 99, units digit first: 100 (v + 0.5) for inches, v + 15 for
/// degrees, 100 v for frequencies. The firmware reads +0.50 inch as -0.50, takes 1.00 for a
/// frequency of 0, uses left-handed pitch and yaw, and saturates silently at the limits of the
/// mechanism. The functions below convert the signs and refuse commands that would trigger the
/// other effects.
using SprkPositionFrame = std::array<char, 13>;
using SprkWaveFrame = std::array<char, 25>;

/// A motion about home that lasts until the next command. Entry k moves between -amplitude and
/// amplitude, except that the breath moves x, y and z between 0 and twice the amplitude. The
/// firmware does not report the phase.
struct SprkWave {
  kinematics::PlatformPose amplitude;
  Eigen::Matrix<double, 6, 1> frequency_hz = Eigen::Matrix<double, 6, 1>::Zero();
};

enum class SprkWaveKind { kSine, kBreath };

/// Returns the middle of the wave's range.
[[nodiscard]] kinematics::PlatformPose SprkWaveMiddle(
    SprkWaveKind kind, const kinematics::PlatformPose& amplitude) noexcept;

/// Encodes the pose nearest to `pose` in steps of 0.254 mm and 1 degree, and writes it to `sent`.
/// Range: -12.7 mm to +12.446 mm, +-15 degrees. Checks the reach of kinematics::SprkPlatform after
/// rounding, for a rigid plate and for the firmware's. Never allocates.
[[nodiscard]] SprkStatus EncodeSprkPosition(const kinematics::PlatformPose& pose,
                                            SprkPositionFrame& frame,
                                            kinematics::PlatformPose& sent) noexcept;

/// Encodes a wave in the steps of a pose. Frequencies have steps of 0.01 Hz up to 0.99 Hz for the
/// sine, and of 0.01 rad/s up to 0.99 rad/s (0.157 Hz) for the breath. The phases of the entries
/// drift apart, so the whole box of the amplitudes must be within reach. Checks its corners, the
/// centres of its edges and faces, and the straight lines from home to these. Never allocates.
[[nodiscard]] SprkStatus EncodeSprkWave(SprkWaveKind kind, const SprkWave& wave,
                                        SprkWaveFrame& frame, SprkWave& sent) noexcept;

}  // namespace dfr::hardware
