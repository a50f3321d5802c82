#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace dfr::kinematics {

/// Joints of a patient-side manipulator: yaw, pitch, insertion (m), roll, wrist pitch, wrist yaw
/// (rad), in the order of the console's `measured_js`.
using PsmJoints = Eigen::Matrix<double, 6, 1>;

/// Why a pose has, or has not, joint values.
enum class PsmReach {
  kOk,
  kInvalid,     ///< A non-finite entry.
  kSingular,    ///< At the remote centre of motion, or on the axis of the wrist.
  kJointLimit,  ///< The arm would have to leave a joint's limits.
};

[[nodiscard]] const char* Name(PsmReach reach) noexcept;

/// Which da Vinci an arm is of. The kinematics are the same; yaw, pitch and insertion of an Si arm
/// go farther.
enum class PsmGeneration { kClassic, kSi };

/// Kinematics of the da Vinci Classic PSM with a Large Needle Driver (400006), modified
/// Denavit-Hartenberg, in metres and radians. Those of an Si PSM with its Large Needle Driver
/// (420006) are the same: the longer shaft begins as much farther back.
///
/// The base frame has its origin at the remote centre of motion, which no joint moves: the shaft's
/// axis passes through it in every configuration. The pose is that of the wrist-yaw axis with the
/// console's tool orientation (z along the closed jaws), what `measured_cp` reports; the jaw tips
/// are kJawLength further along z. All yaw, pitch, roll and wrist angles zero, insertion 0.12 m:
/// the wrist is at (0, 0, -0.1135) and the tool points down.
///
/// Nothing here allocates or throws.
class Psm {
 public:
  static constexpr double kJawLength = 0.0102;  ///< m, from the wrist-yaw axis to the jaw tips.
  /// No point of the tool is farther from the remote centre, m.
  static constexpr double kReach = 0.31;

  [[nodiscard]] static PsmJoints lower_limits(
      PsmGeneration generation = PsmGeneration::kClassic) noexcept;
  [[nodiscard]] static PsmJoints upper_limits(
      PsmGeneration generation = PsmGeneration::kClassic) noexcept;
  /// Finite and within all limits.
  [[nodiscard]] static bool WithinLimits(
      const PsmJoints& q, PsmGeneration generation = PsmGeneration::kClassic) noexcept;

  /// The pose of the wrist in the base frame. Any `q` is accepted, also beyond the limits.
  [[nodiscard]] static Eigen::Isometry3d Forward(const PsmJoints& q) noexcept;
  /// The jaw tips' position in the base frame, m.
  [[nodiscard]] static Eigen::Vector3d Tip(const PsmJoints& q) noexcept;

  /// Where the shaft ends: the wrist-pitch axis in the base frame, m.
  [[nodiscard]] static Eigen::Vector3d ShaftEnd(const PsmJoints& q) noexcept;

  /// The joint values for a pose of the wrist, in closed form: the solution with the wrist bent by
  /// less than a right angle, the only one within the limits. Except for kInvalid and kSingular,
  /// `q` is written, so that a message can tell which joint is too far.
  [[nodiscard]] static PsmReach Inverse(
      const Eigen::Isometry3d& pose, PsmJoints& q,
      PsmGeneration generation = PsmGeneration::kClassic) noexcept;
};

/// A systematic error of the arm's joint readings: the joints really are at
///   q + offset + scale * (q - reference),
/// entry by entry. Cables stretch and potentiometers drift; a calibration estimates this part.
struct PsmCorrection {
  PsmJoints offset = PsmJoints::Zero();
  PsmJoints scale = PsmJoints::Zero();
  PsmJoints reference = PsmJoints::Zero();

  /// Reading to truth.
  [[nodiscard]] PsmJoints Apply(const PsmJoints& q) const noexcept;
  /// Truth to reading: what to command to be at `q`. @pre every scale > -1
  [[nodiscard]] PsmJoints Invert(const PsmJoints& q) const noexcept;
};

}  // namespace dfr::kinematics
