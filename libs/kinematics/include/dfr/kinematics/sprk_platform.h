#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>

namespace dfr::kinematics {

/// A displacement of the platform's top plate from home: translation in m, then roll, pitch, yaw in
/// rad with the rotation Rz(yaw) Ry(pitch) Rx(roll), right-handed. (The firmware turns yaw and
/// pitch the other way round: a driver has to negate them.)
struct PlatformPose {
  Eigen::Vector3d translation_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d angles_rad = Eigen::Vector3d::Zero();

  [[nodiscard]] Eigen::Isometry3d Transform() const noexcept;
};

/// Inverse kinematics of the SPRK Stewart platform (Patel et al., ISMR 2018): six servos on the
/// base turn arms, each of which moves one leg of fixed length (6-RSS). Geometry and limits are
/// those of the published firmware.
///
/// Its single-axis reach from home is z +8.3/-17.1 mm, x +-27.4 mm, y +29.8/-26.7 mm, roll
/// +8.3/-6.1 degrees, pitch +-6.1, yaw +-23.3: less than the +-15 degrees of the paper. The
/// firmware saturates silently, so ask Reachable() before sending a pose.
///
/// Nothing here allocates or throws.
class SprkPlatform {
 public:
  static constexpr double kArmLength = 0.5 * 0.0254;     ///< m, servo axis to leg.
  static constexpr double kLegLength = 2.33 * 0.0254;    ///< m
  static constexpr double kHomeHeight = 2.5 * 0.0254;    ///< m, top plate above the servo axes.
  static constexpr double kServoLimit = 1.745329251994;  ///< rad: 100 degrees either way.
  static constexpr double kTimeConstant = 0.2;           ///< s, of the published first-order lag.

  /// The servo angles, in rad from horizontal, that put the plate at `pose`.
  /// @returns false, with `angles` unspecified, if a leg is too short or too long, a servo would
  ///   have to go beyond its limits, or an entry is not finite.
  [[nodiscard]] static bool Inverse(const PlatformPose& pose,
                                    std::array<double, 6>& angles) noexcept;
  [[nodiscard]] static bool Reachable(const PlatformPose& pose) noexcept;

  /// The largest share s in [0, 1] of `pose` (all entries scaled) for which all of [0, s] is
  /// reachable, to 1/1024.
  [[nodiscard]] static double ReachableShare(const PlatformPose& pose) noexcept;

  /// Where leg `i` is fixed to the plate (in the plate's frame), and its servo's axis to the base,
  /// and the end of its arm at servo angle `angle` (base frame: z up, origin in the centre of the
  /// servo axes), m. @pre 0 <= i < 6
  [[nodiscard]] static Eigen::Vector3d PlateJoint(int i) noexcept;
  [[nodiscard]] static Eigen::Vector3d ServoAxis(int i) noexcept;
  [[nodiscard]] static Eigen::Vector3d ArmEnd(int i, double angle) noexcept;
};

}  // namespace dfr::kinematics
