#pragma once

#include <cstdint>

#include "dfr/kinematics/psm.h"

namespace dfr::sim {

/// Options for ArmError. The defaults are the accuracy reported for an uncalibrated PSM.
struct ArmErrorOptions {
  std::uint64_t seed = 1;         ///< Identifies the arm: equal seeds are the same arm.
  double mean_error_m = 4.5e-3;   ///< Mean of |true tip - reported tip| over the workspace.
  double mean_residual_m = 5e-4;  ///< The part of it that a PsmCorrection cannot describe.
};

/// How a cable-driven arm deceives itself: the joints are not where its encoders, on the motors'
/// side of the cables, have them. Per joint: a constant offset and a scale, which a calibration can
/// find; waves over the joint's range (pulleys, friction) and over time (cables creep), which it
/// cannot.
///
/// The joints that count are yaw, pitch, insertion and the wrist's; roll has an error too, but
/// turns the tool about itself.
class ArmError {
 public:
  /// No error.
  ArmError() = default;
  /// @throws std::invalid_argument if a mean is negative or not finite, or the residual is larger
  ///   than the whole.
  explicit ArmError(const ArmErrorOptions& options);

  /// Where the joints are when the encoders say `q`. `drift` is the phase of the creep, rad. Never
  /// allocates.
  [[nodiscard]] kinematics::PsmJoints Truth(const kinematics::PsmJoints& q,
                                            double drift) const noexcept;

  /// The part that a calibration can find.
  [[nodiscard]] const kinematics::PsmCorrection& systematic() const noexcept { return systematic_; }

 private:
  kinematics::PsmCorrection systematic_;
  kinematics::PsmJoints wave_ = kinematics::PsmJoints::Zero();       // amplitude over the range
  kinematics::PsmJoints wave_rate_ = kinematics::PsmJoints::Zero();  // per rad, per m
  kinematics::PsmJoints wave_phase_ = kinematics::PsmJoints::Zero();
  kinematics::PsmJoints creep_ = kinematics::PsmJoints::Zero();  // amplitude over time
  kinematics::PsmJoints creep_phase_ = kinematics::PsmJoints::Zero();
};

}  // namespace dfr::sim
