#pragma once

#include <mujoco/mujoco.h>

#include <array>

namespace dfr::sim::internal {

inline constexpr int kArmJoints = 7;

/// Changes the quasi-static model for mj_step(): gravity, arm joints with rotor inertia, viscous
/// damping and Coulomb friction, the cylinder's friction on the table, contacts that act when
/// surfaces touch, and a time step of 2 ms.
void MakeDynamic(mjModel& model);

/// One control under full dynamics, in substeps. The motors follow a minimum-jerk reference from
/// the current joint angles to `target` and hold `target` until arm and cylinder are at rest.
///
/// Motors: torque = kp (reference - angle) + kd d(reference)/dt + compensation of gravity and
/// Coriolis forces, each within the torque limit; the joint's own damping is kd. No motion is
/// imposed: the arm yields to contact.
class DynamicMotion {
 public:
  static constexpr double kTimeStep = 0.002;  ///< s
  static constexpr double kPeakSpeed = 0.25;  ///< rad/s, reference speed of the fastest joint
  /// Speed below which a joint is at rest, rad/s.
  static constexpr double kRestJointSpeed = 1e-3;
  /// Speed below which the cylinder is at rest, m/s.
  static constexpr double kRestObjectSpeed = 1e-3;
  static constexpr int kRestSteps = 5;     ///< number of consecutive steps at rest
  static constexpr int kMostSteps = 1500;  ///< 3 s, after which the state is accepted

  /// @param data  data at rest; its velocities are set to zero.
  DynamicMotion(const mjModel* model, mjData* data,
                const std::array<double, kArmJoints>& target) noexcept;

  /// Runs one mj_step(). @return false in the cases of QuasiStaticStep().
  [[nodiscard]] bool Step() noexcept;
  [[nodiscard]] bool AtRest() const noexcept { return resting_ >= kRestSteps; }
  [[nodiscard]] bool Done() const noexcept { return AtRest() || steps_ >= kMostSteps; }
  [[nodiscard]] int steps() const noexcept { return steps_; }

 private:
  const mjModel* model_;
  mjData* data_;
  std::array<double, kArmJoints> start_{};
  std::array<double, kArmJoints> target_;
  double duration_ = 0.0;
  int steps_ = 0;
  int resting_ = 0;
};

}  // namespace dfr::sim::internal
