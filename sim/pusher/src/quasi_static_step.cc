#include "quasi_static_step.h"

#include <cmath>
#include <csetjmp>
#include <cstdio>
#include <cstdlib>
#include <mutex>

namespace dfr::sim::internal {
namespace {

// Jump target of OnError() on this thread. MuJoCo is written in C and holds no resources that a
// jump could leak.
thread_local std::jmp_buf* resume = nullptr;

void OnError(const char* message) {
  if (resume != nullptr) std::longjmp(*resume, 1);
  // Outside a step the process must end: MuJoCo cannot continue after an error.
  std::fprintf(stderr, "MuJoCo: %s\n", message);
  std::exit(EXIT_FAILURE);
}

// Prints nothing: GuardedStep() reads the counters of warnings in mjData.
void OnWarning(const char*) {}

int NumWarnings(const mjData* data) noexcept {
  int sum = 0;
  for (const mjWarningStat& warning : data->warning) sum += warning.number;
  return sum;
}

// Stages of mj_step() that have an effect without gravity, actuators and velocity-dependent forces.
void Step(const mjModel* m, mjData* d) noexcept {
  mj_kinematics(m, d);
  mj_comPos(m, d);
  mj_collision(m, d);
  // The margin only detects contacts; the constraint is on the surfaces themselves.
  for (int i = 0; i < d->ncon; ++i) d->contact[i].includemargin = 0.0;
  mj_makeConstraint(m, d);
  mj_referenceConstraint(m, d);
  mju_zero(d->qfrc_smooth, m->nv);
  mju_zero(d->qacc_smooth, m->nv);
  mj_fwdConstraint(m, d);
  mju_copy(d->qacc_warmstart, d->qacc, m->nv);
  const double h = m->opt.timestep;
  for (int i = 0; i < m->nv; ++i) {  // all joints are hinges and slides: nq = nv
    d->qvel[i] += h * d->qacc[i];
    d->qpos[i] += h * d->qvel[i];
  }
}

}  // namespace

void InstallMujocoHandlers() {
  static std::once_flag once;
  std::call_once(once, [] {
    if (mju_user_error == nullptr) mju_user_error = OnError;
    if (mju_user_warning == nullptr) mju_user_warning = OnWarning;
  });
}

void ResetQuasiStatic(const mjModel* m, mjData* d) noexcept {
  mj_resetDataKeyframe(m, d, 0);
  mj_kinematics(m, d);
  mj_comPos(m, d);
  mj_crb(m, d);
  mj_factorM(m, d);
}

bool QuasiStaticStep(const mjModel* m, mjData* d) noexcept { return GuardedStep(m, d, Step); }

bool GuardedStep(const mjModel* m, mjData* d, void (*step)(const mjModel*, mjData*)) noexcept {
  std::jmp_buf here;
  if (setjmp(here) != 0) {
    resume = nullptr;
    return false;
  }
  resume = &here;
  step(m, d);
  resume = nullptr;
  double sum = 0.0;
  for (int i = 0; i < m->nv; ++i) sum += d->qpos[i];
  return std::isfinite(sum) && NumWarnings(d) == 0;
}

}  // namespace dfr::sim::internal
