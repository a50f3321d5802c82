#pragma once

#include <mujoco/mujoco.h>

namespace dfr::sim::internal {

/// Makes MuJoCo's errors and warnings fit for a control loop: by default an error ends the process
/// and a warning writes a file. Handlers that the host program has set are left in place.
/// Idempotent and thread-safe.
void InstallMujocoHandlers();

/// Brings `data` to the model's home pose at rest, with the joint-space inertia that
/// QuasiStaticStep() uses. Computed once, because all but the armature is negligible in it.
void ResetQuasiStatic(const mjModel* model, mjData* data) noexcept;

/// One substep of quasi-static pushing. On entry qpos is the configuration and qvel the imposed
/// velocity, that of the pushed object zero; on return qpos has moved by qvel times the time step,
/// qvel holds what the contacts made of it, and the kinematics are those on entry.
///
/// With the model's solref = (2 h, 0.5) and the object starting from rest, MuJoCo's contact solver
/// solves the position-level complementarity problem of the substep (Anitescu and Potra, 1997):
/// the gap at its end is >= 0, the contact force is >= 0, one of the two is 0, and friction is in
/// its cone. A contact therefore acts before the surfaces touch, if they would in this substep.
///
/// @return false if MuJoCo raised an error, counted a warning (a full buffer) or the result is not
///   finite: `data` is then worthless until ResetQuasiStatic(). Never allocates.
[[nodiscard]] bool QuasiStaticStep(const mjModel* model, mjData* data) noexcept;

/// Any step, with the same promises; `step` holds nothing that a jump out of it could leak.
[[nodiscard]] bool GuardedStep(const mjModel* model, mjData* data,
                               void (*step)(const mjModel*, mjData*)) noexcept;

}  // namespace dfr::sim::internal
