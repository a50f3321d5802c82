#pragma once

#include <mujoco/mujoco.h>

namespace dfr::sim::internal {

/// Adapts MuJoCo's errors and warnings to a control loop: by default, an error ends the process and
/// a warning writes a file. Does not replace the host program's handlers. Idempotent and
/// thread-safe.
void InstallMujocoHandlers();

/// Sets `data` to the model's home pose at rest, with the joint-space inertia for
/// QuasiStaticStep(). The inertia is constant, because all of it except the armature is negligible.
void ResetQuasiStatic(const mjModel* model, mjData* data) noexcept;

/// Runs one substep of quasi-static pushing. On entry, qpos is the configuration and qvel the
/// imposed velocity, zero for the pushed object. On return, qpos has moved by qvel times the time
/// step, qvel is the velocity after contact, and the kinematics are those on entry.
///
/// With the model's solref = (2 h, 0.5) and the object starting from rest, MuJoCo's contact solver
/// solves the position-level complementarity problem of the substep (Anitescu and Potra, 1997): the
/// gap at its end is >= 0, the contact force is >= 0, one of the two is 0, and friction is in its
/// cone. A contact therefore acts before the surfaces touch, if they would touch in this substep.
///
/// @return false if MuJoCo raised an error, counted a warning (a full buffer) or the result is not
///   finite: `data` is then unusable until ResetQuasiStatic(). Never allocates.
[[nodiscard]] bool QuasiStaticStep(const mjModel* model, mjData* data) noexcept;

/// Runs any step with the guarantees of QuasiStaticStep(). `step` must not hold resources that a
/// jump out of it would leak.
[[nodiscard]] bool GuardedStep(const mjModel* model, mjData* data,
                               void (*step)(const mjModel*, mjData*)) noexcept;

}  // namespace dfr::sim::internal
