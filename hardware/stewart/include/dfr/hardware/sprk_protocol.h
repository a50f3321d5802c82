#pragma once

#include <Eigen/Core>
#include <array>

#include "dfr/kinematics/sprk_platform.h"

namespace dfr::hardware {

/// What became of a command to the platform. Anything but kOk sent nothing and moved nothing,
/// except kDeviceFailed, after which the pose is unknown.
enum class SprkStatus {
  kOk,
  kInvalid,       ///< A non-finite entry.
  kOutOfRange,    ///< Two digits cannot say it.
  kOutOfReach,    ///< The mechanism cannot go there, or would leave its reach on the way.
  kNotHomed,      ///< No successful Home() yet: where the platform is, nobody knows.
  kTooSoon,       ///< Less than kSprkFramePeriod after the frame before.
  kDeviceFailed,  ///< Writing failed. Only a new driver, homed again, goes on.
};

[[nodiscard]] const char* Name(SprkStatus status) noexcept;

/// s from one frame to the next, at least: the firmware loses bytes of frames that come faster.
inline constexpr double kSprkFramePeriod = 0.005;

/// The published protocol: 57600 baud 8N1, ASCII, no acknowledgement, no checksum, no feedback.
///   h                  home
///   a + 12 digits      position: x, y, z, roll, pitch, yaw
///   c, d + 24 digits   sine, breath: amplitude and frequency of x, y, z, roll, pitch, yaw
/// Each value is a whole number from 0 to 99, units digit first: 100 (v + 0.5) for inches, v + 15
/// for degrees, 100 v for frequencies. The firmware takes +0.50 inch for -0.50 and 1.00 for a
/// frequency of 0, turns pitch and yaw left-handed, and saturates silently where the mechanism
/// ends. None of that can happen with what these functions encode: they refuse it.
using SprkPositionFrame = std::array<char, 13>;
using SprkWaveFrame = std::array<char, 25>;

/// A motion about home that goes on until the next command. With the sine, entry k moves between
/// -amplitude and amplitude; with the breath, between 0 and twice the amplitude. The firmware does
/// not tell the phase.
struct SprkWave {
  kinematics::PlatformPose amplitude;
  Eigen::Matrix<double, 6, 1> frequency_hz = Eigen::Matrix<double, 6, 1>::Zero();
};

enum class SprkWaveKind { kSine, kBreath };

/// Encodes the pose that is nearest to `pose` in steps of 0.254 mm and 1 degree, and writes it to
/// `sent`. Range: -12.7 mm to +12.446 mm, +-15 degrees. Rounding comes before the check of reach,
/// which is that of kinematics::SprkPlatform. Never allocates.
[[nodiscard]] SprkStatus EncodeSprkPosition(const kinematics::PlatformPose& pose,
                                            SprkPositionFrame& frame,
                                            kinematics::PlatformPose& sent) noexcept;

/// Encodes a wave in the same way; frequencies in steps of 0.01 Hz up to 0.99 Hz for the sine, and
/// of 0.01 rad/s up to 0.99 rad/s (0.157 Hz) for the breath. Because the entries' phases run apart,
/// all of the box that the amplitudes span must be within reach, of which its corners, the middles
/// of its edges and faces, and the straight lines from home to these are checked. Never allocates.
[[nodiscard]] SprkStatus EncodeSprkWave(SprkWaveKind kind, const SprkWave& wave,
                                        SprkWaveFrame& frame, SprkWave& sent) noexcept;

}  // namespace dfr::hardware
