#pragma once

#include <mujoco/mujoco.h>

#include <array>

namespace dfr::sim::internal {

inline constexpr int kArmJoints = 7;

/// Makes of the quasi-static model one for mj_step(): gravity, arm joints with rotor inertia,
/// viscous damping and Coulomb friction, the cylinder's friction on the table, contacts that act
/// where surfaces touch, a time step of 2 ms.
void MakeDynamic(mjModel& model);

/// One control under full dynamics, substep by substep: the motors follow a minimum-jerk reference
/// from the present joint angles to `target`, and hold it until all is at rest.
///
/// Motors: torque = kp (reference - angle) + kd d(reference)/dt + what gravity and Coriolis forces
/// ask, each within the torque limit; the joint's own damping is kd. Nothing is imposed: the arm
/// yields to what it touches.
class DynamicMotion {
 public:
  static constexpr double kTimeStep = 0.002;        ///< s
  static constexpr double kPeakSpeed = 0.25;        ///< rad/s, of the fastest joint's reference
  static constexpr double kRestJointSpeed = 1e-3;   ///< rad/s: at rest below, each joint,
  static constexpr double kRestObjectSpeed = 1e-3;  ///< m/s: and the cylinder,
  static constexpr int kRestSteps = 5;              ///< for so many steps in a row.
  static constexpr int kMostSteps = 1500;           ///< 3 s: then it is taken as it is.

  /// @param data  at rest; velocities are set to zero.
  DynamicMotion(const mjModel* model, mjData* data,
                const std::array<double, kArmJoints>& target) noexcept;

  /// One mj_step(). @return false as QuasiStaticStep().
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
