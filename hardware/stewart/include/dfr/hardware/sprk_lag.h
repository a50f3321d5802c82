#pragma once

#include "dfr/kinematics/sprk_platform.h"

namespace dfr::hardware {

/// Estimates the platform's pose from its published dynamics: each entry follows the commanded
/// entry with a first-order lag of SprkPlatform::kTimeConstant,
///   x(t) = c + (x(t_c) - c) exp(-(t - t_c) / tau),  c commanded at t_c.
/// The platform has no sensor. Its published position errors are 1.22, 1.07 and 0.20 mm RMS in x, y
/// and z. Nothing here allocates or throws.
class SprkLag {
 public:
  /// Sets the state to rest at `pose`.
  void Rest(const kinematics::PlatformPose& pose, double time_s) noexcept;
  /// Sets the command to `pose` at `time_s`, not before the last command.
  void Command(const kinematics::PlatformPose& pose, double time_s) noexcept;
  /// @pre time_s not before the last command.
  [[nodiscard]] kinematics::PlatformPose At(double time_s) const noexcept;
  [[nodiscard]] const kinematics::PlatformPose& commanded() const noexcept { return commanded_; }

 private:
  kinematics::PlatformPose from_;
  kinematics::PlatformPose commanded_;
  double time_s_ = 0.0;
};

}  // namespace dfr::hardware
