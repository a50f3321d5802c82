#include "dfr/control/certified/certified_controller.h"

#include <algorithm>
#include <cmath>

#include "dfr/control/certified/constants.h"
#include "dfr/control/constants.h"
#include "dfr/control/guided/guided_options.h"
#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

using core::AsSpan;

StepLimits Limits(const CertifiedOptions& options, int control_dim, double control_unit) {
  return ScaledLimits(options.control_limit, control_dim, control_unit, options.iterations);
}

void Check(const CertifiedOptions& options) {
  for (const double limit : options.correction_limit) {
    DFR_THROW_UNLESS(limit >= 0.0, "correction_limit must not be negative: " << limit);
  }
  Check(GuidedOptions{.horizon = options.horizon,
                      .first_step = options.first_step,
                      .max_controls = options.max_controls,
                      .control_limit = options.control_limit,
                      .iterations = options.iterations,
                      .patience = options.patience,
                      .probe_size = options.probe_size});
}

CertifiedController::CertifiedController(const core::Policy& policy, const TaskView& task,
                                         const CertifiedOptions& options)
    : policy_(&policy),
      task_(task),
      first_step_((CheckFits(policy, task), Check(options), options.first_step)),
      limits_(Limits(options, task.response().control_dim(), task.response().control_unit())),
      corrections_(limits_),
      most_corrected_(options.correction_limit.empty()
                          ? limits_.control
                          : ScaledLimits(options.correction_limit, task.response().control_dim(),
                                         task.response().control_unit(), 0)
                                .control),
      max_exit_level_(
          std::min(certified::kMaxExitRatio * task.levels().slack(), guided::kMaxExitLevel)),
      probe_size_(options.probe_size),
      demonstrated_(options.demonstrated),
      halt_rule_{options.horizon, options.max_controls, options.patience},
      estimate_(task.response().prior(), {}, /*drift=*/false),
      fit_(estimate_.MakeFit()),
      tracker_(task.support()),
      certifier_(options.certificate, task.features().num_features(), task.response().control_dim(),
                 task.response().control_unit()) {
  for (Eigen::VectorXd* z : {&z_, &dz_, &effect_}) {
    *z = Eigen::VectorXd::Zero(task.features().num_features());
  }
  v_ = learned_ = Eigen::VectorXd::Zero(task.response().control_dim());
  limits_.values = corrections_.values = task.response().values();
}

void CertifiedController::DoReset(std::uint64_t /*seed*/) noexcept {
  estimate_.Reset();
  tracker_.Reset(first_step_);
  certifier_.Reset();
  progress_ = {.time = static_cast<double>(first_step_)};
}

Step CertifiedController::DoNext(std::span<const double> x, std::span<double> u) noexcept {
  const core::LogDecisionFunction& support = task_.support();
  task_.features().Apply(x, AsSpan(z_));
  Step step{.t = tracker_.phase(), .iteration = tracker_.waited()};
  if (progress_.controls > 0) {
    dz_ = z_ - core::AsVector(fit_.z());
    if (const auto violation = certifier_.FindViolation(v_, effect_, dz_)) {
      step.observed_error = *violation;
      return Halted(step, HaltCause::kViolated);
    }
    estimate_.Update(fit_, AsSpan(v_), AsSpan(dz_));
  }

  const double least = -certifier_.level();
  step.log_g = tracker_.Enter(AsSpan(z_), least);
  step.t = tracker_.phase();
  step.g = support.FromLog(step.t, step.log_g);
  if (!std::isfinite(step.log_g)) return Halted(step, HaltCause::kSupportInvalid);
  if (step.log_g < least) return Halted(step, HaltCause::kOutsideSupport);
  progress_.waited = tracker_.waited();
  if (const HaltCause cause = halt_rule_(progress_); cause != HaltCause::kNone) {
    return Halted(step, cause);
  }

  policy_->Control(step.t, x, u);
  learned_ = core::AsVector(std::span<const double>(u)) / task_.response().control_unit();
  if (!learned_.allFinite()) return Halted(step, HaltCause::kControlInvalid);
  const bool within = !limits_.Limit(learned_);
  corrections_.control = limits_.control.cwiseMin(most_corrected_.cwiseMax(learned_.cwiseAbs()));
  v_ = learned_;
  estimate_.FitAt(step.t, AsSpan(z_), fit_);
  const LocalModel model{support, fit_};
  const StepTarget target{step.t + 1, task_.levels().median(step.t + 1)};
  step.log_threshold = target.level;
  step.threshold = support.FromLog(step.t, step.log_threshold);
  const bool deep = DeepInside(step.log_g, target.level);
  step.mode = deep ? Mode::kPolicy : Correct(model, target);
  if (!Certify(model, step)) return Halted(step, HaltCause::kNoProgress);
  const bool passes = step.mode == Mode::kPolicy && within && v_ == learned_;
  step.filtered = step.mode == Mode::kPolicy && !passes;
  // A control that passes is unchanged, bit for bit.
  if (!passes) {
    step.change = (v_ - core::AsVector(u) / task_.response().control_unit()).norm();
    core::AsVector(u) = v_ * task_.response().control_unit();
  }
  ++progress_.controls;
  return step;
}

bool CertifiedController::DeepInside(double level, double hi) const noexcept {
  return level >= hi && learned_.norm() <= task_.response().largest_control() &&
         task_.support().LogDecision(tracker_.phase() + 1, AsSpan(z_), {}) >= hi;
}

// Raises the level of v_, the learned control, or replaces it by a probe.
Mode CertifiedController::Correct(const LocalModel& model, const StepTarget& target) noexcept {
  const double level = AscendSupport(model, target, corrections_, v_);
  const Probe probe{probe_size_, target.phase};
  if (level < 0.0 && TakeProbe(task_.support(), fit_, limits_, probe, v_)) return Mode::kProbe;
  return level >= -max_exit_level_ ? Mode::kPolicy : Mode::kRecovery;
}

bool CertifiedController::Certify(const LocalModel& model, Step& step) noexcept {
  const Certifier::CertifiedStep admission =
      certifier_.Admit(model, fit_, corrections_, {step.t, step.mode, demonstrated_}, v_);
  if (!admission.any) return false;
  step.mode = admission.mode;
  step.demonstrated = admission.demonstrated;
  step.certified = true;
  effect_.noalias() = fit_.jacobian().lazyProduct(v_);
  // Enter() searches around the phase at which the control aims.
  if (!admission.gets_on) {
    tracker_.Wait();
  } else {
    // Small fractions add up to time steps.
    const double before = std::floor(progress_.time + 0.5);
    progress_.time += admission.share;
    tracker_.Reset(step.t + static_cast<int>(std::floor(progress_.time + 0.5) - before));
  }
  return true;
}

}  // namespace dfr::control
