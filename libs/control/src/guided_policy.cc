#include "dfr/control/guided_policy.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"

namespace dfr::control {
namespace {

using core::AsSpan;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Largest eigenvalue of A^-1 beyond which a direction of control counts as unknown: a fifth of an
// ordinary control's measurement.
constexpr double kUnknown = 5.0;
// A support from so few demonstrations that others are further outside than this does not know the
// task, whatever their slack.
constexpr double kMostReach = 0.8;
// Inside, whatever rounding does.
constexpr double kInside = 1e-6;
// A certified control of which less than this share passes is a stall; so many in a row end it.
constexpr double kLeastShare = 0.02;
constexpr int kMaxStalls = 3;

constexpr std::array<std::string_view, 10> kParts = {
    "filter",          "reach",      "demonstrated", "overtaking", "probing",
    "online-jacobian", "own-motion", "lag",          "smoothing",  "drift"};

Step Halt(Step step, HaltCause cause) noexcept {
  step.mode = Mode::kHalt;
  step.cause = cause;
  return step;
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
  DFR_THROW_UNLESS(options.horizon > 0, "horizon must be positive, not " << options.horizon);
  DFR_THROW_UNLESS(options.first_step >= 0 && options.first_step < options.horizon,
                   "first_step must lie in [0, horizon), not " << options.first_step);
  DFR_THROW_UNLESS(options.max_controls > 0,
                   "max_controls must be positive, not " << options.max_controls);
  DFR_THROW_UNLESS(options.control_limit > 0.0,
                   "control_limit must be positive, not " << options.control_limit);
  DFR_THROW_UNLESS(options.iterations >= 0,
                   "iterations must not be negative: " << options.iterations);
  DFR_THROW_UNLESS(options.patience > 0, "patience must be positive, not " << options.patience);
  DFR_THROW_UNLESS(options.probe_size >= 0.0,
                   "probe_size must not be negative: " << options.probe_size);
  DFR_THROW_UNLESS(options.reach >= 0.0, "reach must not be negative: " << options.reach);
  DFR_THROW_UNLESS(options.tolerance >= 0.0,
                   "tolerance must not be negative: " << options.tolerance);
  DFR_THROW_UNLESS(options.certificate.kind == CertificateKind::kNone || options.tolerance == 0.0,
                   Name(options.certificate.kind) << " tolerates nothing: tolerance must be zero");
  DFR_THROW_UNLESS(options.online_weight >= 0.0,
                   "online_weight must not be negative: " << options.online_weight);
  DFR_THROW_UNLESS(
      options.certificate.kind == CertificateKind::kNone ||
          (options.drift_time.rest == 0.0 && options.drift_time.travel == 0.0),
      Name(options.certificate.kind)
          << " holds only where nothing else moves the world: drift_time must be zero");
}

// A certificate assumes that controls act at once, and alone, and that states are seen as they are.
EstimateScope Scope(const GuidedModel& model, const GuidedOptions& options) {
  if (options.certificate.kind != CertificateKind::kNone) return {false, false, false};
  return {.own_motion = options.own_motion && model.own_motion(),
          .lag = options.lag,
          .smoothing = options.smoothing};
}

}  // namespace

std::span<const std::string_view> GuidedPartNames() noexcept { return kParts; }

GuidedOptions Without(GuidedOptions options, std::string_view parts) {
  while (!parts.empty()) {
    const std::string_view part = parts.substr(0, parts.find('+'));
    parts.remove_prefix(std::min(parts.size(), part.size() + 1));
    if (part == "filter") {
      options.iterations = 0;
    } else if (part == "reach") {
      options.reach = 0.0;
    } else if (part == "demonstrated") {
      options.demonstrated = false;
    } else if (part == "overtaking") {
      options.overtakes = false;
    } else if (part == "probing") {
      options.probe_size = 0.0;
    } else if (part == "online-jacobian") {
      options.online_weight = 0.0;
    } else if (part == "own-motion") {
      options.own_motion = false;
    } else if (part == "lag") {
      options.lag = false;
    } else if (part == "smoothing") {
      options.smoothing = false;
    } else if (part == "drift") {
      options.drift_time = {};
    } else {
      std::string known;
      for (const std::string_view name : kParts) {
        known.append(known.empty() ? "" : ", ").append(name);
      }
      DFR_THROW_UNLESS(false, "guided recovery has no part '" << part << "'; it has: " << known);
    }
  }
  return options;
}

GuidedPolicy::GuidedPolicy(const core::Policy& policy, const GuidedModel& model,
                           const GuidedOptions& options)
    : policy_(&policy),
      model_(&model),
      options_((Check(policy, model, options), options)),
      limits_{options.control_limit / model.control_unit(), options.iterations},
      halt_rule_{options.horizon, options.max_controls, options.patience},
      estimate_(model.prior(), options.drift_time, Scope(model, options)),
      reach_(std::min(options.reach * model.slack(), kMostReach)),
      tracker_(model.support()),
      certifier_(options.certificate, model.features().num_features(), model.control_dim(),
                 model.control_unit()) {
  for (Eigen::VectorXd* v : {&z_, &seen_, &last_seen_, &effect_, &dz_}) {
    *v = Eigen::VectorXd::Zero(model.features().num_features());
  }
  for (Eigen::VectorXd* v : {&v_, &learned_, &trial_, &demonstrated_}) {
    *v = Eigen::VectorXd::Zero(model.control_dim());
  }
}

void GuidedPolicy::DoReset(std::uint64_t /*seed*/) noexcept {
  estimate_.Reset();
  tracker_.Reset(options_.first_step);
  certifier_.Reset();
  progress_ = {.time = static_cast<double>(options_.first_step)};
  stalls_ = 0;
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
    estimate_.Update(AsSpan(last_seen_), AsSpan(v_), AsSpan(dz_), options_.online_weight);
  }
  z_ = seen_;
  estimate_.Smooth(z_);
  estimate_.AddPending(z_);

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
  learned_ = learned_.cwiseMax(-limits_.control).cwiseMin(limits_.control);
  step.log_threshold = Gate(step.t + 1);
  step.threshold = support.FromLog(step.t, step.log_threshold);

  v_ = learned_;
  const LocalModel local{support, estimate_, AsSpan(z_)};
  const bool deep = DeepInside(step.log_g);
  // J is most of the work. Deep inside only the first controls ask for it, because they show a lag.
  if (!deep || certifier_.active() ||
      (options_.lag && progress_.controls <= JacobianEstimate::kMaxLag)) {
    estimate_.Compute(step.t, AsSpan(z_));
  }
  Choice choice = deep ? Choice{Mode::kPolicy, step.log_threshold} : Choose(local);
  if (!deep && Probe(local, choice.level)) choice.mode = Mode::kProbe;
  step.mode = choice.mode;
  if (certifier_.active()) {
    if (!Certify(local, step)) return Halt(step, HaltCause::kNoProgress);
  } else {
    Advance(local, choice.level);
  }
  step.filtered = step.mode == Mode::kPolicy && !deep && v_ != learned_;
  core::AsVector(u) = v_ * model_->control_unit();
  last_seen_ = seen_;
  ++progress_.controls;
  return step;
}

bool GuidedPolicy::DeepInside(double level) const noexcept {
  const int phase = tracker_.phase();
  const double hi = Gate(phase + 1);
  return level >= hi && learned_.norm() <= model_->largest_control(phase) &&
         model_->support().LogDecision(phase + 1, AsSpan(z_), {}) >= hi;
}

GuidedPolicy::Choice GuidedPolicy::Choose(const LocalModel& model) noexcept {
  const int next = tracker_.phase() + 1;
  const StepTarget target{next, Gate(next)};
  // The last support does not move on: deep inside it, or where it is nearest, a task would stop.
  const bool last = next >= model_->support().num_steps();
  const double learned = model.Level(next, v_);
  if (learned >= (options_.tolerance > 0.0 ? -options_.tolerance : target.level)) {
    return {Mode::kPolicy, std::max(learned, 0.0)};
  }
  const Mode corrected = learned >= 0.0 ? Mode::kPolicy : Mode::kRecovery;
  // A certificate shrinks what leads outside until nothing is left.
  const bool known =
      options_.demonstrated && !certifier_.active() && estimate_.Demonstrated(trial_);
  double demonstrated = -kInfinity;
  if (known) {
    trial_ = trial_.cwiseMax(-limits_.control).cwiseMin(limits_.control);
    demonstrated_ = trial_;
    demonstrated = RaiseLevel(model, {next, last ? kInside : target.level}, limits_, trial_);
    if (demonstrated >= 0.0) {
      v_ = trial_;
      return {corrected, demonstrated};
    }
  }
  const double filtered = RaiseLevel(model, target, limits_, v_);
  if (filtered >= 0.0) return {Mode::kPolicy, filtered};
  if (!(known && last) && std::max(demonstrated, filtered) >= -reach_) {
    if (demonstrated <= filtered) return {Mode::kPolicy, 0.0};
    v_ = trial_;
    return {corrected, 0.0};
  }
  if (!known) return {Mode::kRecovery, filtered};
  v_ = demonstrated_;
  return {Mode::kRecovery, model.Level(next, v_)};
}

void GuidedPolicy::Advance(const LocalModel& model, double level) noexcept {
  if (tracker_.Advance(level) || !options_.overtakes) return;
  dz_ = z_;
  model.answer.AddEffect(v_, dz_);
  static_cast<void>(tracker_.Overtake(AsSpan(dz_)));
}

bool GuidedPolicy::Probe(const LocalModel& model, double& level) noexcept {
  const int next = tracker_.phase() + 1;
  const bool drifts = options_.drift_time.rest > 0.0 || options_.drift_time.travel > 0.0;
  // What is predicted inside is worth no probe, unless the prediction needs to know a drift.
  if (options_.probe_size == 0.0 || level >= (drifts ? Gate(next) : 0.0) ||
      estimate_.Ignorance() <= kUnknown || estimate_.LeastKnown(AsSpan(trial_)) <= kUnknown) {
    return false;
  }
  v_ = (options_.probe_size * trial_).cwiseMax(-limits_.control).cwiseMin(limits_.control);
  level = model.Level(next, v_);
  // In a drift the sign says which of the two is not known.
  if (drifts) return true;
  trial_ = -v_;
  if (const double other = model.Level(next, trial_); other > level) {
    v_ = trial_;
    level = other;
  }
  return true;
}

bool GuidedPolicy::Project(const LocalModel& model, int phase) noexcept {
  // The need is met a little later than it is computed: the slope of l differs where v leads to.
  constexpr int kRounds = 3;
  constexpr double kOvershoot = 0.02;
  PredictedLevel there = model.Predict(phase, v_);
  Certifier::Need need = certifier_.Check(model, phase, v_, there);
  for (int round = 0; round < kRounds && !need.met(); ++round) {
    if (RaiseLevel(model, {phase, need.level + kOvershoot}, limits_, v_, there) < need.level) break;
    need = certifier_.Check(model, phase, v_, there);
  }
  return need.met();
}

bool GuidedPolicy::Certify(const LocalModel& model, Step& step) noexcept {
  bool gets_on = step.mode != Mode::kProbe;
  double share = 1.0;
  if (gets_on && certifier_.predicts()) {
    trial_ = v_;
    if (!Project(model, step.t + 1)) {
      // What demonstrations did nearby, as near to it as is certified.
      demonstrated_ = trial_;
      const bool known = estimate_.Demonstrated(v_);
      v_ = v_.cwiseMax(-limits_.control).cwiseMin(limits_.control);
      if (known && Project(model, step.t + 1)) {
        step.mode = Mode::kRecovery;
      } else {
        v_ = demonstrated_;
        share = certifier_.Part(model, step.t, v_);
      }
    }
  } else {
    share = certifier_.Share(model, step.t, v_);
  }
  if (share < kLeastShare) {
    // So near to the boundary in this direction: make all the room there is first.
    v_.setZero();
    static_cast<void>(RaiseLevel(model, {step.t, kInfinity}, limits_, v_));
    step.mode = Mode::kRecovery;
    gets_on = false;
    share = certifier_.Share(model, step.t, v_);
  }
  stalls_ = share < kLeastShare || v_.isZero() ? stalls_ + 1 : 0;
  if (stalls_ >= kMaxStalls) return false;
  v_ *= share;
  effect_.noalias() = estimate_.jacobian().lazyProduct(v_);
  step.certified = true;
  // Enter() finds the phase that the control leads to, from the one it is meant to lead to.
  if (!gets_on) {
    static_cast<void>(tracker_.Advance(-kInfinity));
  } else {
    // Small shares add up to time steps.
    const double before = std::floor(progress_.time + 0.5);
    progress_.time += share;
    tracker_.Reset(step.t + static_cast<int>(std::floor(progress_.time + 0.5) - before));
  }
  return true;
}

}  // namespace dfr::control
