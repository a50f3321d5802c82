#include "dfr/control/guided_policy.h"

#include <algorithm>
#include <cmath>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"

namespace dfr::control {
namespace {

using core::AsSpan;

Step Halt(Step step, HaltCause cause) noexcept {
  step.mode = Mode::kHalt;
  step.cause = cause;
  return step;
}

bool Certifies(const GuidedOptions& options) noexcept {
  return options.certificate.kind != CertificateKind::kNone;
}

void Check(const core::Policy& policy, const GuidedModel& model, const GuidedOptions& options) {
  DFR_THROW_UNLESS(policy.state_dim() == model.features().state_dim(),
                   "the policy takes states of " << policy.state_dim() << " entries, the features "
                                                 << model.features().state_dim());
  DFR_THROW_UNLESS(policy.control_dim() == model.control_dim(),
                   "the policy gives " << policy.control_dim()
                                       << " control entries, demonstrations "
                                       << model.control_dim());
  DFR_THROW_UNLESS(
      std::max(model.features().num_features(), model.control_dim()) <= kMaxStepEntries,
      "guided recovery takes at most " << kMaxStepEntries << " features and control entries");
  Check(options);
}

}  // namespace

GuidedPolicy::GuidedPolicy(const core::Policy& policy, const GuidedModel& model,
                           const GuidedOptions& options)
    : policy_(&policy),
      model_(&model),
      options_((Check(policy, model, options), options)),
      limits_(Limits(options, model.control_dim(), model.control_unit())),
      halt_rule_{options.horizon, options.max_controls, options.patience},
      // A certificate assumes that controls act at once, and alone, and that states are what is
      // seen.
      estimate_(model.prior(), options.drift_time,
                options.own_motion && model.own_motion() && !Certifies(options)),
      observer_(model.features().num_features(), model.control_dim(),
                model.prior()->options().forgetting, options.observer && !Certifies(options)),
      correction_(model, options),
      tracker_(model.support()),
      certifier_(options.certificate, model.features().num_features(), model.control_dim(),
                 model.control_unit()) {
  for (Eigen::VectorXd* v : {&z_, &seen_, &last_seen_, &effect_, &dz_}) {
    *v = Eigen::VectorXd::Zero(model.features().num_features());
  }
  v_ = learned_ = Eigen::VectorXd::Zero(model.control_dim());
}

void GuidedPolicy::DoReset(std::uint64_t /*seed*/) noexcept {
  estimate_.Reset();
  observer_.Reset();
  tracker_.Reset(options_.first_step);
  certifier_.Reset();
  progress_ = {.time = static_cast<double>(options_.first_step)};
}

Step GuidedPolicy::DoNext(std::span<const double> x, std::span<double> u) noexcept {
  const core::LogDecisionFunction& support = model_->support();
  model_->features().Apply(x, AsSpan(seen_));
  Step step{.t = tracker_.phase(), .iteration = tracker_.waited()};
  if (progress_.controls > 0) {
    dz_ = seen_ - last_seen_;
    if (!certifier_.Confirms(progress_.controls - 1, v_, effect_, dz_)) {
      return Halt(step, HaltCause::kViolated);
    }
    observer_.Update(estimate_, AsSpan(v_), AsSpan(dz_));
    estimate_.Update(AsSpan(last_seen_), observer_.acting(), AsSpan(dz_), estimate_.Time(v_),
                     options_.online_weight);
  }
  z_ = seen_;
  observer_.Observe(estimate_, z_);

  step.log_g = certifier_.active() ? tracker_.Enter(AsSpan(z_), -certifier_.level())
                                   : support.LogDecision(tracker_.phase(), AsSpan(z_), {});
  step.t = tracker_.phase();
  step.g = support.FromLog(step.t, step.log_g);
  if (!std::isfinite(step.log_g)) return Halt(step, HaltCause::kSupportInvalid);
  if (certifier_.active() && step.log_g < -certifier_.level()) {
    return Halt(step, HaltCause::kOutsideSupport);
  }
  progress_.waited = tracker_.waited();
  if (!certifier_.active()) progress_.time = tracker_.phase();
  if (const HaltCause cause = halt_rule_(progress_); cause != HaltCause::kNone) {
    return Halt(step, cause);
  }

  policy_->Control(step.t, x, u);
  learned_ = core::AsVector(std::span<const double>(u)) / model_->control_unit();
  if (!learned_.allFinite()) return Halt(step, HaltCause::kControlInvalid);
  const double asked = learned_.squaredNorm();
  learned_ = learned_.cwiseMax(-limits_.control).cwiseMin(limits_.control);
  const bool within = learned_.squaredNorm() == asked;
  step.log_threshold =
      options_.least_intervention ? model_->pass_level(step.t + 1) : Gate(step.t + 1);
  step.threshold = support.FromLog(step.t, step.log_threshold);

  v_ = learned_;
  const bool deep = DeepInside(step.log_g);
  // J is most of the work. Deep inside only the first controls ask for it, because they show a lag.
  if (!deep || certifier_.active() ||
      (options_.observer && progress_.controls <= StateObserver::kMaxLag)) {
    estimate_.Compute(step.t, AsSpan(z_));
  }
  Correction::Choice choice{Mode::kPolicy, step.log_threshold};
  if (!deep) {
    choice = correction_.Choose(estimate_, AsSpan(z_), {step.t + 1, Gate(step.t + 1)},
                                step.log_threshold, v_);
  }
  step.mode = choice.mode;
  if (certifier_.active()) {
    if (!Certify(step)) return Halt(step, HaltCause::kNoProgress);
  } else {
    Advance(choice.level);
  }
  const bool passes = step.mode == Mode::kPolicy && within && v_ == learned_;
  step.filtered = step.mode == Mode::kPolicy && !passes;
  // What passes does so to the bit.
  if (!passes) core::AsVector(u) = v_ * model_->control_unit();
  last_seen_ = seen_;
  ++progress_.controls;
  return step;
}

bool GuidedPolicy::DeepInside(double level) const noexcept {
  const int phase = tracker_.phase();
  const double hi = Gate(phase + 1);
  return level >= hi && learned_.norm() <= model_->largest_control() &&
         model_->support().LogDecision(phase + 1, AsSpan(z_), {}) >= hi;
}

void GuidedPolicy::Advance(double level) noexcept {
  if (level >= 0.0) return tracker_.Advance();
  dz_ = z_;
  estimate_.AddEffect(v_, dz_);
  tracker_.Advance(AsSpan(dz_), level, !(level >= -correction_.reach()));
}

bool GuidedPolicy::Certify(Step& step) noexcept {
  const LocalModel model{model_->support(), estimate_, AsSpan(z_)};
  const Certifier::Admission admission =
      certifier_.Admit(model, estimate_, limits_, {step.t, step.mode}, v_);
  if (!admission.any) return false;
  step.mode = admission.mode;
  step.certified = true;
  effect_.noalias() = estimate_.jacobian().lazyProduct(v_);
  // Enter() finds the phase that the control leads to, from the one it is meant to lead to.
  if (!admission.gets_on) {
    tracker_.Wait();
  } else {
    // Small shares add up to time steps.
    const double before = std::floor(progress_.time + 0.5);
    progress_.time += admission.share;
    tracker_.Reset(step.t + static_cast<int>(std::floor(progress_.time + 0.5) - before));
  }
  return true;
}

}  // namespace dfr::control
