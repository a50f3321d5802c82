#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace dfr::kinematics {

/// Joints of a patient-side manipulator: yaw, pitch, insertion (m), roll, wrist pitch, wrist yaw
/// (rad), in the order of the console's `measured_js`.
using PsmJoints = Eigen::Matrix<double, 6, 1>;

/// Result of an inverse kinematics query.
enum class PsmReach {
  kOk,
  kInvalid,     ///< A non-finite entry.
  kSingular,    ///< The wrist-yaw axis passes through the remote centre, or the wrist is at it.
  kJointLimit,  ///< The pose requires a joint value beyond its limit.
};

[[nodiscard]] const char* Name(PsmReach reach) noexcept;

/// Generation of the da Vinci arm. The kinematics are identical; the limits of yaw, pitch and
/// insertion are wider on an Si arm.
enum class PsmGeneration { kClassic, kSi };

/// Kinematics of the da Vinci Classic PSM with a Large Needle Driver (400006), in metres and
/// radians, by modified Denavit-Hartenberg parameters. An Si PSM with its Large Needle Driver
/// (420006) has the same kinematics: its longer shaft starts correspondingly farther back.
///
/// The origin of the base frame is the remote centre of motion, which no joint moves: the shaft's
/// axis passes through it in every configuration. Poses are those of the wrist-yaw axis in the
/// console's tool orientation (z along the closed jaws), as `measured_cp` reports them. The jaw
/// tips are kJawLength further along z. With yaw, pitch, roll and wrist angles zero and insertion
/// 0.12 m, the wrist is at (0, 0, -0.1135) and the tool points down.
///
/// No member allocates or throws.
class Psm {
 public:
  static constexpr double kJawLength = 0.0102;  ///< m, from the wrist-yaw axis to the jaw tips.
  /// Upper bound on the distance of any point of the tool from the remote centre, m.
  static constexpr double kReach = 0.31;

  [[nodiscard]] static PsmJoints lower_limits(
      PsmGeneration generation = PsmGeneration::kClassic) noexcept;
  [[nodiscard]] static PsmJoints upper_limits(
      PsmGeneration generation = PsmGeneration::kClassic) noexcept;
  /// Returns true if all entries are finite and within their limits.
  [[nodiscard]] static bool WithinLimits(
      const PsmJoints& q, PsmGeneration generation = PsmGeneration::kClassic) noexcept;

  /// Returns the pose of the wrist in the base frame. Accepts any `q`, including values beyond the
  /// limits.
  [[nodiscard]] static Eigen::Isometry3d Forward(const PsmJoints& q) noexcept;
  /// Returns the twist of the wrist in the base frame, m/s and then rad/s, for the rates `velocity`
  /// of the joints `q`. Accurate to 1e-7 of the speed.
  [[nodiscard]] static Eigen::Matrix<double, 6, 1> Twist(const PsmJoints& q,
                                                         const PsmJoints& velocity) noexcept;
  /// Returns the position of the jaw tips in the base frame, m.
  [[nodiscard]] static Eigen::Vector3d Tip(const PsmJoints& q) noexcept;
  /// Maximum of NumParts().
  static constexpr int kMostParts = 1024;
  /// Returns the number of equal parts, from 1 to kMostParts, into which to divide the joint motion
  /// `way`. Within a part, no point of the tool moves more than 0.5 mm unless the whole motion
  /// exceeds 0.5 m. Returns 1 if an entry is not finite.
  [[nodiscard]] static int NumParts(const PsmJoints& way) noexcept;

  /// Computes the joint values for a pose of the wrist in closed form. Returns the solution with
  /// the wrist bent by less than a right angle, the only one within the limits. Writes `q` for kOk,
  /// and also for kJointLimit, to show which joint is beyond its limit.
  [[nodiscard]] static PsmReach Inverse(
      const Eigen::Isometry3d& pose, PsmJoints& q,
      PsmGeneration generation = PsmGeneration::kClassic) noexcept;
};

/// Systematic error of the arm's joint readings. The true joint values are
///   q + offset + scale * (q - reference),
/// entry by entry. Cable stretch and potentiometer drift cause this error; a calibration estimates
/// it.
struct PsmCorrection {
  PsmJoints offset = PsmJoints::Zero();
  PsmJoints scale = PsmJoints::Zero();
  PsmJoints reference = PsmJoints::Zero();

  /// Converts readings to true joint values.
  [[nodiscard]] PsmJoints Apply(const PsmJoints& q) const noexcept;
  /// Converts true joint values to readings: returns the command that moves the joints to `q`. @pre
  /// every scale > -1
  [[nodiscard]] PsmJoints Invert(const PsmJoints& q) const noexcept;
};

}  // namespace dfr::kinematics
