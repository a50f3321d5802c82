#include "dynamic_motion.h"

#include <algorithm>
#include <cmath>

#include "dfr/sim/mujoco/mujoco_model.h"
#include "quasi_static_step.h"

namespace dfr::sim::internal {
namespace {

constexpr double kGravity = 9.81;              // m/s^2
constexpr double kArmature = 0.1;              // kg m^2, inertia of each geared rotor
constexpr double kDamping = 60.0;              // kd, N m s/rad
constexpr double kStiffness = 2000.0;          // kp, N m/rad
constexpr double kJointFriction = 0.2;         // N m
constexpr double kTorqueLimit = 100.0;         // N m
constexpr double kObjectFriction = 0.5;        // Coulomb friction of the cylinder on the table
constexpr double kLeastDuration = 0.04;        // s, minimum duration of a control
constexpr double kContactTimeConstant = 0.01;  // s

void StepTwo(const mjModel* m, mjData* d) { mj_step2(m, d); }
void StepOne(const mjModel* m, mjData* d) { mj_step1(m, d); }

}  // namespace

void MakeDynamic(mjModel& m) {
  m.opt.timestep = DynamicMotion::kTimeStep;
  m.opt.solver = mjSOL_NEWTON;
  m.opt.gravity[2] = -kGravity;
  for (int j = 0; j < kArmJoints; ++j) {
    m.dof_armature[j] = kArmature;
    m.dof_damping[j] = kDamping;
    m.dof_frictionloss[j] = kJointFriction;
  }
  const int object = MujocoId(m, mjOBJ_BODY, "object");
  for (int j = kArmJoints; j < m.nv; ++j) {
    m.dof_frictionloss[j] = kObjectFriction * m.body_mass[object] * kGravity;
  }
  for (int pair = 0; pair < m.npair; ++pair) {
    m.pair_margin[pair] = std::min(m.pair_margin[pair], 0.0);
    m.pair_solref[mjNREF * pair] = kContactTimeConstant;
    m.pair_solref[mjNREF * pair + 1] = 1.0;
  }
  // Updates the values that MuJoCo derives from inertia, such as the stiffness of constraints.
  const MjDataPtr data(mj_makeData(&m));
  mj_setConst(&m, data.get());
}

DynamicMotion::DynamicMotion(const mjModel* model, mjData* data,
                             const std::array<double, kArmJoints>& target) noexcept
    : model_(model), data_(data), target_(target) {
  double farthest = 0.0;
  for (int j = 0; j < kArmJoints; ++j) {
    start_[j] = data->qpos[j];
    farthest = std::max(farthest, std::abs(target[j] - start_[j]));
  }
  // A minimum-jerk motion is fastest at its midpoint: 15/8 of its mean speed.
  duration_ = std::max(kLeastDuration, 15.0 / 8.0 * farthest / kPeakSpeed);
  mju_zero(data->qvel, model->nv);
  // Clears the solver's state.
  mju_zero(data->qacc_warmstart, model->nv);
}

bool DynamicMotion::Step() noexcept {
  const mjModel* m = model_;
  mjData* d = data_;
  if (!GuardedStep(m, d, StepOne)) return false;
  const double s = std::min(1.0, (steps_ + 1) * kTimeStep / duration_);
  const double done = s * s * s * (10.0 + s * (6.0 * s - 15.0));
  const double rate = 30.0 * s * s * (1.0 - s) * (1.0 - s) / duration_;
  for (int j = 0; j < kArmJoints; ++j) {
    const double way = target_[j] - start_[j];
    const double torque = kStiffness * (start_[j] + done * way - d->qpos[j]) +
                          kDamping * rate * way + d->qfrc_bias[j];
    d->qfrc_applied[j] = std::clamp(torque, -kTorqueLimit, kTorqueLimit);
  }
  if (!GuardedStep(m, d, StepTwo)) return false;
  ++steps_;
  bool still =
      s >= 1.0 && std::hypot(d->qvel[kArmJoints], d->qvel[kArmJoints + 1]) < kRestObjectSpeed;
  for (int j = 0; j < kArmJoints; ++j) still = still && std::abs(d->qvel[j]) < kRestJointSpeed;
  resting_ = still ? resting_ + 1 : 0;
  return true;
}

}  // namespace dfr::sim::internal
