#pragma once

#include <cstdint>

#include "dfr/kinematics/psm.h"

namespace dfr::sim {

/// Options for ArmError. The defaults give the reported accuracy of an uncalibrated PSM.
struct ArmErrorOptions {
  std::uint64_t seed = 1;         ///< Identifies the arm: equal seeds give the same arm.
  double mean_error_m = 4.5e-3;   ///< Mean of |true tip - reported tip| over the workspace.
  double mean_residual_m = 5e-4;  ///< Part of this error that a PsmCorrection cannot describe.
};

/// Errors of a cable-driven arm: its encoders, on the motors' side of the cables, differ from the
/// joint positions. Per joint, there are a constant offset and a scale, which a calibration can
/// identify, and waves over the joint's range (pulleys, friction) and over time (cable creep),
/// which it cannot identify.
///
/// Yaw, pitch, insertion and the wrist's joints affect the tip. Roll has an error too, but only
/// rotates the tool about its axis.
class ArmError {
 public:
  /// Creates an arm without errors.
  ArmError() = default;
  /// @throws std::invalid_argument if a mean is negative or not finite, or the residual exceeds the
  ///   total.
  explicit ArmError(const ArmErrorOptions& options);

  /// Returns the true joint positions for the encoder reading `q`. `drift` is the phase of the
  /// creep, rad. Never allocates.
  [[nodiscard]] kinematics::PsmJoints Truth(const kinematics::PsmJoints& q,
                                            double drift) const noexcept;

  /// Part of the error that a calibration can identify.
  [[nodiscard]] const kinematics::PsmCorrection& systematic() const noexcept { return systematic_; }

 private:
  // Returns the part of the error that a calibration cannot identify.
  [[nodiscard]] kinematics::PsmJoints Residual(const kinematics::PsmJoints& q,
                                               double drift) const noexcept;

  kinematics::PsmCorrection systematic_;
  kinematics::PsmJoints wave_ = kinematics::PsmJoints::Zero();       // amplitude over the range
  kinematics::PsmJoints wave_rate_ = kinematics::PsmJoints::Zero();  // per rad, per m
  kinematics::PsmJoints wave_phase_ = kinematics::PsmJoints::Zero();
  kinematics::PsmJoints creep_ = kinematics::PsmJoints::Zero();  // amplitude over time
  kinematics::PsmJoints creep_phase_ = kinematics::PsmJoints::Zero();
};

}  // namespace dfr::sim
