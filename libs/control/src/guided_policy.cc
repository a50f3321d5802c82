#include "dfr/control/guided_policy.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"

namespace dfr::control {
namespace {

using core::AsSpan;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// As a share of the learned control's effect that a climb has to keep: none.
constexpr double kAnywhere = -kInfinity;

constexpr std::array<GuidedPartName, 14> kPartNames = {{
    {"margin-gate", &GuidedParts::margin_gate},
    {"filter", &GuidedParts::filter},
    {"re-entry", &GuidedParts::reentry},
    {"online-jacobian", &GuidedParts::online_jacobian},
    {"re-alignment", &GuidedParts::realignment},
    {"probing", &GuidedParts::probing},
    {"trust-region", &GuidedParts::trust_region},
    {"backtracking", &GuidedParts::backtracking},
    {"slack", &GuidedParts::slack},
    {"gentle-outside", &GuidedParts::gentle_outside},
    {"hold-best", &GuidedParts::hold_best},
    {"patience", &GuidedParts::patience},
    {"phase-hold", &GuidedParts::phase_hold},
    {"phase-search", &GuidedParts::phase_search},
}};

Step Halt(Step step, HaltCause cause) noexcept {
  step.mode = Mode::kHalt;
  step.cause = cause;
  return step;
}

}  // namespace

std::span<const GuidedPartName> GuidedPartNames() noexcept { return kPartNames; }

GuidedPolicy::GuidedPolicy(const core::Policy& policy, const GuidedModel& model,
                           const GuidedOptions& options, const core::Policy* fallback)
    : policy_(&policy),
      model_(&model),
      fallback_(fallback),
      options_(options),
      estimate_(model.prior(), options.drift_time) {
  DFR_THROW_UNLESS(policy.state_dim() == model.features().state_dim(),
                   "the policy takes states of " << policy.state_dim() << " entries, the features "
                                                 << model.features().state_dim());
  DFR_THROW_UNLESS(policy.control_dim() == model.control_dim(),
                   "the policy gives " << policy.control_dim()
                                       << " control entries, demonstrations "
                                       << model.control_dim());
  DFR_THROW_UNLESS(fallback == nullptr || (fallback->state_dim() == policy.state_dim() &&
                                           fallback->control_dim() == policy.control_dim()),
                   "the fallback policy differs in its sizes from the policy");
  DFR_THROW_UNLESS(options.horizon > 0, "horizon must be positive, not " << options.horizon);
  DFR_THROW_UNLESS(options.first_step >= 0 && options.first_step < options.horizon,
                   "first_step must lie in [0, horizon), not " << options.first_step);
  DFR_THROW_UNLESS(options.max_controls > 0,
                   "max_controls must be positive, not " << options.max_controls);
  DFR_THROW_UNLESS(options.control_limit > 0.0,
                   "control_limit must be positive, not " << options.control_limit);
  DFR_THROW_UNLESS(options.phase_window >= 0,
                   "phase_window must not be negative: " << options.phase_window);
  DFR_THROW_UNLESS(options.climb_step > 0.0 && options.probe_size > 0.0,
                   "climb_step and probe_size must be positive");
  const Certificate& certificate = options.certificate;
  DFR_THROW_UNLESS((certificate.kind != CertificateKind::kLipschitz &&
                    certificate.kind != CertificateKind::kRadius) ||
                       (certificate.gain > 0.0 && std::isfinite(certificate.gain)),
                   Name(certificate.kind)
                       << " needs a gain K that is positive and finite, not " << certificate.gain);
  DFR_THROW_UNLESS(
      certificate.kind != CertificateKind::kDirection ||
          (certificate.direction_error > 0.0 && std::isfinite(certificate.direction_error)),
      "certified-direction needs an eps that is positive and finite, not "
          << certificate.direction_error);
  DFR_THROW_UNLESS(certificate.kind == CertificateKind::kNone ||
                       (options.drift_time.rest == 0.0 && options.drift_time.travel == 0.0),
                   Name(certificate.kind) << " holds only where nothing else moves the world: "
                                             "drift_time must be zero");
  const int n = model.features().num_features();
  const int m = model.control_dim();
  for (Eigen::VectorXd* v : {&z_, &last_z_, &last_effect_, &dz_, &effect_, &learned_effect_,
                             &there_, &gradient_, &shift_}) {
    *v = Eigen::VectorXd::Zero(n);
  }
  for (Eigen::VectorXd* v : {&last_v_, &learned_, &v_, &reach_, &trial_, &direction_}) {
    *v = Eigen::VectorXd::Zero(m);
  }
  const int phases = 2 * options.phase_window + 1;
  balls_.resize(static_cast<std::size_t>(phases));
  shifts_ = core::Matrix::Zero(phases, n);
}

void GuidedPolicy::DoReset(std::uint64_t seed) noexcept {
  estimate_.Reset();
  random_ = core::Random(seed);
  phase_ = options_.first_step;
  time_ = options_.first_step;
  controls_ = 0;
  recovery_controls_ = 0;
  stalls_ = 0;
  without_gain_ = 0;
  without_advance_ = 0;
  furthest_ = -1;
  best_log_ = -kInfinity;
  trust_ = 1.0;
  violation_ = {};
  pending_ = false;
}

Step GuidedPolicy::DoNext(std::span<const double> x, std::span<double> u) noexcept {
  const GuidedParts& parts = options_.parts;
  const bool certified = options_.certificate.kind != CertificateKind::kNone;
  model_->features().Apply(x, AsSpan(z_));
  Step step;
  step.iteration = recovery_controls_;
  known_balls_ = 0;
  if (pending_) {
    dz_ = z_ - last_z_;
    if (certified && !AssumptionHolds()) {
      step.t = phase_;
      return Halt(step, HaltCause::kViolated);
    }
    Learn();
  }
  const bool aligned = Align();
  step.t = phase_;
  step.log_g = log_;
  if (!std::isfinite(log_)) return Halt(step, HaltCause::kSupportInvalid);
  if (!aligned || (log_ < 0.0 && !parts.reentry)) return Halt(step, HaltCause::kOutsideSupport);
  if (time_ >= options_.horizon) return Halt(step, HaltCause::kTimeUp);
  if (controls_ >= options_.max_controls) return Halt(step, HaltCause::kIterationLimit);

  if (phase_ > furthest_) {
    furthest_ = phase_;
    without_advance_ = 0;
  } else {
    ++without_advance_;
  }

  policy_->Control(phase_, x, u);
  learned_ = core::AsVector(std::span<const double>(u)) / model_->control_unit();
  if (!learned_.allFinite()) return Halt(step, HaltCause::kControlInvalid);
  const double limit = 2.0 * std::max(model_->largest_control(phase_), 0.3);
  Limit(learned_, kInfinity);

  const double hi = parts.margin_gate ? model_->gate_level(phase_ + 1) : 0.02;
  step.threshold = hi;
  v_ = learned_;
  bool open;
  if (parts.margin_gate) {
    open = log_ >= hi && learned_.norm() <= 3.0 * limit &&
           model_->support().LogDecision(phase_ + 1, AsSpan(z_), {}) >= hi;
    // J is most of the work, and deep inside nobody asks for it.
    if (!open || certified) estimate_.Compute(phase_, AsSpan(z_));
  } else {
    estimate_.Compute(phase_, AsSpan(z_));
    open = LogAfter(phase_ + 1, v_, {}) >= hi;
  }
  step.mode = Mode::kPolicy;
  next_phase_ = phase_ + 1;
  if (!open) {
    const bool margins = !(parts.patience && without_advance_ > options_.patience);
    bool filtered = Pass(learned_, limit, margins);
    if (!filtered && fallback_ != nullptr) {
      fallback_->Control(phase_, x, u);
      trial_ = core::AsVector(std::span<const double>(u)) / model_->control_unit();
      if (trial_.allFinite()) {
        Limit(trial_, kInfinity);
        learned_ = trial_;
        filtered = Pass(learned_, limit, margins);
      }
    }
    if (!filtered && !Recover(limit, step.mode)) {
      // Margins are a wish, being inside the aim: they must not be what ends the task.
      filtered = parts.patience && margins && log_ >= 0.0 && Pass(learned_, limit, false);
      if (!filtered) {
        return Halt(step, recovery_controls_ >= options_.max_recovery ? HaltCause::kIterationLimit
                                                                      : HaltCause::kNoProgress);
      }
    }
    step.filtered = filtered;
  }

  double share = 1.0;
  if (certified) {
    share = Certify();
    if (share < options_.least_share && step.mode == Mode::kPolicy) {
      // So near to the boundary in this direction: make room first.
      step.filtered = false;
      if (!Recover(limit, step.mode)) return Halt(step, HaltCause::kNoProgress);
      share = Certify();
    }
    if (share < options_.least_share) {
      if (++stalls_ >= options_.max_stalls) return Halt(step, HaltCause::kNoProgress);
    }
    step.certified = true;
  }
  return Emit(step, share, u);
}

Step GuidedPolicy::Emit(Step step, double share, std::span<double> u) noexcept {
  v_ *= share;
  core::AsVector(u) = v_ * model_->control_unit();
  last_z_ = z_;
  last_v_ = v_;
  pending_ = true;
  pending_recovery_ = step.mode == Mode::kRecovery;
  pending_phase_ = phase_;
  pending_log_ = log_;
  pending_predicted_ = pending_recovery_ ? LogAfter(phase_, v_, {}) : log_;
  if (step.certified) last_effect_.noalias() = estimate_.jacobian().lazyProduct(v_);
  ++controls_;
  if (step.mode == Mode::kPolicy) {
    time_ += share;
    if (share >= 0.5) phase_ = next_phase_;
    recovery_controls_ = 0;
    stalls_ = 0;
    without_gain_ = 0;
    best_log_ = -kInfinity;
    step.iteration = 0;
  } else {
    ++recovery_controls_;
  }
  return step;
}

bool GuidedPolicy::AssumptionHolds() noexcept {
  // Rounding of the features is all that may come on top.
  constexpr double kRounding = 1e-9;
  const Certificate& certificate = options_.certificate;
  const double norm = last_v_.norm() * model_->control_unit();
  const bool direction = certificate.kind == CertificateKind::kDirection;
  const double change = direction ? (dz_ - last_effect_).norm() : dz_.norm();
  const double allowed = direction ? certificate.direction_error : certificate.gain;
  if (change <= allowed * norm * (1.0 + kRounding) + kRounding) return true;
  violation_ = {controls_ - 1, norm > 0.0 ? change / norm : kInfinity, allowed};
  return false;
}

void GuidedPolicy::Learn() noexcept {
  if (options_.parts.online_jacobian) estimate_.Update(AsSpan(last_v_), AsSpan(dz_));
  if (!options_.parts.trust_region || !pending_recovery_) return;
  const double predicted = pending_predicted_ - pending_log_;
  if (predicted <= 0.0) return;
  const double gain = model_->support().LogDecision(pending_phase_, AsSpan(z_), {}) - pending_log_;
  trust_ = gain < 0.1 * predicted ? trust_ / 2.0 : std::min(1.0, trust_ * 1.5);
}

bool GuidedPolicy::Align() noexcept {
  const bool certified = options_.certificate.kind != CertificateKind::kNone;
  const int window = options_.parts.realignment ? options_.phase_window : 0;
  // With a certificate the last control provably ends in one of the phases around the one it was
  // chosen at, which is one less than phase_ if that has advanced.
  const int first = std::max(0, phase_ - (certified ? options_.phase_window + 1 : window));
  const int last = phase_ + (certified ? options_.phase_window : window);
  const double penalty = options_.phase_penalty * model_->gate_level(phase_);
  const int from = phase_;
  double best_score = -kInfinity;
  log_ = -kInfinity;
  bool found = false;
  const auto consider = [&](int q) {
    const double l = model_->support().LogDecision(q, AsSpan(z_), {});
    if (certified && l < 0.0 && (found || q != from)) return;
    if (certified && l >= 0.0 && !found) {
      best_score = -kInfinity;
      found = true;
    }
    const double score = l - penalty * std::min(std::abs(q - from), options_.phase_window);
    if (score > best_score) {
      best_score = score;
      phase_ = q;
      log_ = l;
    }
  };
  for (int q = first; q <= last; ++q) consider(q);
  // A phase that does not advance may be the wrong one: one further on that the state is inside of
  // as well, or an earlier one to approach from again. Four phases a control, further away from
  // control to control, and round again.
  if (options_.parts.phase_search && without_advance_ > options_.patience / 2) {
    const int steps = model_->support().num_steps();
    const int furthest = std::max({1, from, steps - 1 - from});
    const int reach = window + 1 + 2 * (without_advance_ - options_.patience / 2) % furthest;
    for (const int q : {from + reach, from + reach + 1, from - reach, from - reach - 1}) {
      if (q >= 0 && q < steps) consider(q);
    }
    if (std::abs(phase_ - from) > window + 1) {
      furthest_ = phase_;
      without_advance_ = 0;
    }
  }
  return !certified || log_ >= 0.0;
}

double GuidedPolicy::LogAfter(int phase, const Eigen::VectorXd& v,
                              std::span<double> gradient) noexcept {
  there_ = z_;
  estimate_.AddEffect(v, there_);
  return model_->support().LogDecision(phase, AsSpan(there_), gradient);
}

void GuidedPolicy::Limit(Eigen::VectorXd& v, double limit) const noexcept {
  const double norm = v.norm();
  if (norm > limit) v *= limit / norm;
  const double most = options_.control_limit / model_->control_unit();
  v = v.cwiseMax(-most).cwiseMin(most);
}

double GuidedPolicy::Climb(int phase, Eigen::VectorXd& v, double l, double target, double limit,
                           double progress) noexcept {
  // What is less than these, changes nothing that is decided by a climb.
  constexpr double kLeastStep = 0.02;
  constexpr double kLeastGain = 1e-3;
  constexpr double kLeastShare = 0.05;  // Of what is missing to the target.
  constexpr double kGrowth = 1.5;
  const double curvature = model_->support().curvature_bound(phase);
  double size = options_.climb_step;
  for (int i = 0; i < options_.climb_iterations && l < target; ++i) {
    direction_.noalias() = estimate_.jacobian().transpose().lazyProduct(gradient_);
    const double slope = direction_.norm();
    if (!(slope > 0.0)) break;
    direction_ /= slope;
    effect_.noalias() = estimate_.jacobian().lazyProduct(direction_);
    // A step s gains slope s - bend s^2 at least, which is most at this one.
    const double bend = curvature * effect_.squaredNorm();
    const double sure = slope / (2.0 * bend);
    const double sure_gain = slope * sure / 2.0;
    const double missing = target - l + 1e-9;
    if (sure_gain < std::min(missing, kLeastGain)) break;
    double step = std::max(size, sure);
    if (sure_gain > missing) {
      // No further than surely reaches the target.
      step = std::min(step, sure * (1.0 - std::sqrt(1.0 - missing / sure_gain)));
    }
    step = std::max(step, kLeastStep);
    if (progress > kAnywhere) {
      // The learned control's effect falls linearly, as everything that J says.
      const double loss = -effect_.dot(learned_effect_);
      if (loss > 0.0) {
        shift_.noalias() = estimate_.jacobian().lazyProduct(v);
        const double room = shift_.dot(learned_effect_) - progress * learned_effect_.squaredNorm();
        step = std::min(step, room / loss);
        if (!(step >= kLeastStep)) break;
      }
    }
    trial_ = v + step * direction_;
    Limit(trial_, limit);
    double trial_l = LogAfter(phase, trial_, AsSpan(shift_));
    if (options_.parts.backtracking) {
      if (trial_l <= l && step > sure) {
        step = sure;
        trial_ = v + step * direction_;
        Limit(trial_, limit);
        trial_l = LogAfter(phase, trial_, AsSpan(shift_));
      }
      if (trial_l <= l) break;
    }
    const double gain = trial_l - l;
    v.swap(trial_);
    gradient_.swap(shift_);
    l = trial_l;
    if (options_.parts.backtracking && gain < kLeastShare * (target - l)) break;
    size = kGrowth * step;
  }
  return l;
}

bool GuidedPolicy::Pass(const Eigen::VectorXd& wanted, double limit, bool margins) noexcept {
  if (!options_.parts.filter) return false;
  next_phase_ = phase_ + 1;
  if (Filter(wanted, limit, margins)) return true;
  if (!options_.parts.phase_hold || log_ < 0.0) return false;
  // Where demonstrations were further on by now (an object a little farther away, say), getting on
  // within the present phase is what leads to the next.
  next_phase_ = phase_;
  return Filter(wanted, limit, margins);
}

bool GuidedPolicy::Filter(const Eigen::VectorXd& wanted, double limit, bool margins) noexcept {
  const int phase = next_phase_;
  double lo = options_.parts.margin_gate ? model_->accept_level(phase) : 0.0;
  double hi = options_.parts.margin_gate ? model_->gate_level(phase) : 0.02;
  if (!margins) {
    hi = std::max(lo, 0.02);
    lo = 0.0;
  }
  learned_effect_.noalias() = estimate_.jacobian().lazyProduct(wanted);
  v_ = wanted;
  Limit(v_, limit);
  double l = LogAfter(phase, v_, AsSpan(gradient_));
  // The climb ends where it would give up the learned control's purpose for the last bit of l.
  l = Climb(phase, v_, l, hi, limit, options_.ample_progress);
  if (l >= lo) return true;
  l = Climb(phase, v_, l, lo, limit, options_.least_progress);
  if (l >= lo) return true;
  // What no control can mend (an object that is off to the side, say) must not stop the rest.
  if (!options_.parts.slack || l < -model_->slack()) return false;
  reach_ = v_;
  const double mendable = std::min(lo, l + options_.slack_margin * model_->slack());
  return Climb(phase, reach_, l, mendable, limit, kAnywhere) < mendable;
}

bool GuidedPolicy::Recover(double limit, Mode& mode) noexcept {
  if (log_ > best_log_ + 1e-3) {
    best_log_ = log_;
    without_gain_ = 0;
  } else {
    ++without_gain_;
  }
  if (recovery_controls_ >= options_.max_recovery || stalls_ >= options_.max_stalls) return false;
  if (options_.parts.hold_best && without_gain_ >= options_.max_without_gain) return false;

  if (log_ < 0.0 && options_.parts.gentle_outside) {
    limit = options_.outside_share * std::max(model_->largest_control(phase_), 0.3);
  }
  if (options_.parts.probing && estimate_.Ignorance() > options_.probe_above &&
      estimate_.LeastKnown(AsSpan(direction_)) > options_.probe_above) {
    mode = Mode::kProbe;
    v_ = direction_ * std::min(options_.probe_size, limit);
    trial_ = -v_;
    if (LogAfter(phase_, trial_, {}) > LogAfter(phase_, v_, {})) v_ = trial_;
    Limit(v_, limit);
    return true;
  }
  mode = Mode::kRecovery;
  v_.setZero();
  Climb(phase_, v_, LogAfter(phase_, v_, AsSpan(gradient_)), model_->gate_level(phase_),
        limit * trust_, kAnywhere);
  constexpr double kStall = 0.05;
  constexpr double kShake = 0.15;
  if (v_.norm() < kStall) {
    ++stalls_;
    random_.Direction(AsSpan(trial_));
    v_ += kShake * trial_;
    Limit(v_, limit);
  }
  return true;
}

double GuidedPolicy::Certify() noexcept {
  const Certificate& certificate = options_.certificate;
  const core::LogDecisionFunction& support = model_->support();
  const double norm = v_.norm() * model_->control_unit();
  if (norm == 0.0) return 1.0;
  const int first = std::max(0, phase_ - options_.phase_window);
  const int last = phase_ + options_.phase_window;
  effect_.noalias() = estimate_.jacobian().lazyProduct(v_);
  double best = 0.0;
  for (int q = first; q <= last && best < 1.0; ++q) {
    double share = 0.0;
    if (certificate.kind == CertificateKind::kLipschitz) {
      const double room = support.Decision(q, AsSpan(z_)) / support.lipschitz_bound(q);
      share = room / (certificate.gain * norm) * (1.0 - 1e-9);
    } else {
      SafeBall& ball = balls_[static_cast<std::size_t>(q - first)];
      const std::span<double> shift = core::Row(shifts_, q - first);
      if (q - first == known_balls_) {
        ball = ComputeSafeBall(support, q, AsSpan(z_), shift);
        ++known_balls_;
      }
      share = certificate.kind == CertificateKind::kRadius
                  ? ball.worst_radius() / (certificate.gain * norm) * (1.0 - 1e-9)
                  : LargestShare(ball, shift, AsSpan(effect_), certificate.direction_error * norm);
    }
    best = std::max(best, std::clamp(share, 0.0, 1.0));
  }
  return best;
}

}  // namespace dfr::control
