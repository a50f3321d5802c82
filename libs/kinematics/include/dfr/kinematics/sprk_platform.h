#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>

namespace dfr::kinematics {

/// Displacement of the platform's top plate from home: translation in m, then roll, pitch and yaw
/// in rad, with the rotation Rz(yaw) Ry(pitch) Rx(roll), right-handed. The firmware uses the
/// opposite sign for yaw and pitch; drivers must negate them. The firmware also combines several
/// angles differently: with a yaw of 15 degrees and a roll of 6 degrees, the plate is 2.1 mm off at
/// the joints.
struct PlatformPose {
  Eigen::Vector3d translation_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d angles_rad = Eigen::Vector3d::Zero();

  [[nodiscard]] Eigen::Isometry3d Transform() const noexcept;
};

/// Inverse kinematics of the SPRK Stewart platform (Patel et al., ISMR 2018), a 6-RSS mechanism:
/// six servos on the base turn arms, and each arm moves one leg of fixed length. Geometry and
/// limits come from the published firmware.
///
/// Single-axis range from home: z +8.3/-17.1 mm, x +-27.4 mm, y +29.8/-26.7 mm, roll +8.3/-6.1
/// degrees, pitch +-6.1, yaw +-23.3. The ranges of roll and pitch are smaller than the paper's +-15
/// degrees. The firmware saturates silently; call FirmwareReaches() before sending a pose.
///
/// No member allocates or throws.
class SprkPlatform {
 public:
  static constexpr double kArmLength = 0.5 * 0.0254;     ///< m, servo axis to leg.
  static constexpr double kLegLength = 2.33 * 0.0254;    ///< m
  static constexpr double kHomeHeight = 2.5 * 0.0254;    ///< m, top plate above the servo axes.
  static constexpr double kServoLimit = 1.745329251994;  ///< rad: 100 degrees in each direction.
  static constexpr double kTimeConstant = 0.2;           ///< s, of the published first-order lag.

  /// Computes the servo angles, in rad from horizontal, for the plate pose `pose`.
  /// @returns false, with `angles` unspecified, if a leg is too short or too long, a servo would
  ///   exceed its limits, or an entry is not finite.
  [[nodiscard]] static bool Inverse(const PlatformPose& pose,
                                    std::array<double, 6>& angles) noexcept;
  [[nodiscard]] static bool Reachable(const PlatformPose& pose) noexcept;

  /// Returns the position to which the firmware moves the plate's joint `i` for this pose, m, in
  /// the base frame. @pre 0 <= i < 6
  [[nodiscard]] static Eigen::Vector3d FirmwareJoint(const PlatformPose& pose, int i) noexcept;
  /// Returns true if the firmware does not saturate at this pose. Reachable() checks a separate
  /// condition: a rigid plate can take this pose.
  [[nodiscard]] static bool FirmwareReaches(const PlatformPose& pose) noexcept;

  /// Returns the largest s in [0, 1] for which t * `pose` (every entry scaled) is reachable for all
  /// t in [0, s], with a resolution of 1/1024.
  [[nodiscard]] static double ReachableShare(const PlatformPose& pose) noexcept;

  /// Geometry of leg `i`, m: its joint on the plate (plate's frame), the axis of its servo, and the
  /// end of its arm at servo angle `angle` (both in the base frame: z up, origin at the centre of
  /// the servo axes). @pre 0 <= i < 6
  [[nodiscard]] static Eigen::Vector3d PlateJoint(int i) noexcept;
  [[nodiscard]] static Eigen::Vector3d ServoAxis(int i) noexcept;
  [[nodiscard]] static Eigen::Vector3d ArmEnd(int i, double angle) noexcept;
};

}  // namespace dfr::kinematics
