#include "dfr/control/guided/guided_controller.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dfr/control/constants.h"
#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

using core::AsSpan;

namespace {

constexpr double kUnmeasured = std::numeric_limits<double>::infinity();

}  // namespace

GuidedController::GuidedController(const core::Policy& policy, const TaskView& task,
                                   const GuidedOptions& options)
    : policy_(&policy),
      task_(task),
      options_((CheckFits(policy, task), Check(options), options)),
      limits_(Limits(options, task.response().control_dim(), task.response().control_unit())),
      halt_rule_{options.horizon, options.max_controls, options.patience},
      estimate_(task.response().prior(), options.disturbance_model,
                options.drift && task.response().has_drift()),
      fit_(estimate_.MakeFit()),
      observer_(task.features().num_features(), task.response().control_dim(),
                task.response().prior()->options().forgetting, options.observer),
      filter_(task, options),
      tracker_(task.support()),
      chose_in_(tracker_),
      moved_to_(tracker_),
      workspace_(task.response().prior()->MakeWorkspace()) {
  for (Eigen::VectorXd* v : {&z_, &seen_, &last_seen_, &dz_}) {
    *v = Eigen::VectorXd::Zero(task.features().num_features());
  }
  v_ = chosen_ = learned_ = foreseen_ = Eigen::VectorXd::Zero(task.response().control_dim());
}

void GuidedController::DoReset(std::uint64_t /*seed*/) noexcept {
  estimate_.Reset();
  observer_.Reset();
  tracker_.Reset(options_.first_step);
  progress_ = {};
  at_edge_.Reset();
  corrections_ = 0;
  relocations_ = 0;
  distance_ = kUnmeasured;
}

Step GuidedController::DoNext(std::span<const double> x, std::span<double> u) noexcept {
  See(x);
  const Step step = Look();
  if (step.cause != HaltCause::kNone) return step;
  policy_->Control(step.t, x, u);
  return Decide(step, u);
}

void GuidedController::See(std::span<const double> x) noexcept {
  task_.features().Apply(x, AsSpan(seen_));
  if (progress_.controls > 0) {
    dz_ = seen_ - last_seen_;
    // A single wrong measurement, or a robot moved by hand, would outweigh all effects of actions.
    const TransitionStore& prior = *task_.response().prior();
    const bool plausible = prior.Surrounds(AsSpan(last_seen_)) && prior.Surrounds(AsSpan(seen_));
    observer_.Update(plausible ? &fit_ : nullptr, AsSpan(v_), AsSpan(dz_));
    if (plausible) {
      estimate_.Update(fit_, AsSpan(last_seen_), observer_.acting(), AsSpan(dz_), fit_.Duration(v_),
                       options_.online_weight);
    }
  }
  z_ = seen_;
  observer_.Observe(fit_, z_);
}

void GuidedController::Relocate() noexcept {
  if (!options_.least_intervention || relocations_ == guided::kMostRelocations) return;
  if (tracker_.waited() < std::max(1, options_.patience / 2)) return;
  const double level = task_.support().LogDecision(tracker_.phase(), AsSpan(z_), {});
  if (!(level < -filter_.max_exit_level()) || !tracker_.Relocate(AsSpan(z_))) return;
  ++relocations_;
}

bool GuidedController::LeadsAway(double level) noexcept {
  const double last = distance_;
  distance_ = kUnmeasured;
  if (!(level < -filter_.max_exit_level())) return false;
  distance_ = task_.response().prior()->Distance(AsSpan(seen_), workspace_);
  return distance_ - last > guided::kLeadsAway * (seen_ - last_seen_).norm();
}

Step GuidedController::Look() noexcept {
  Relocate();
  const core::LogDecisionFunction& support = task_.support();
  Step step{.t = tracker_.phase(), .iteration = tracker_.waited()};
  step.log_g = support.LogDecision(step.t, AsSpan(z_), {});
  step.g = support.FromLog(step.t, step.log_g);
  if (!std::isfinite(step.log_g) || !task_.response().prior()->Reaches(AsSpan(z_))) {
    return Halted(step, HaltCause::kSupportInvalid);
  }
  progress_.away = LeadsAway(step.log_g) ? progress_.away + 1 : 0;
  progress_.time = step.t;
  progress_.waited = tracker_.waited();
  const HaltCause cause = halt_rule_(progress_);
  return cause != HaltCause::kNone ? Halted(step, cause) : step;
}

Step GuidedController::Decide(Step step, std::span<double> u) noexcept {
  learned_ = core::AsVector(std::span<const double>(u)) / task_.response().control_unit();
  if (!learned_.allFinite()) return Halted(step, HaltCause::kControlInvalid);
  const bool within = !limits_.Limit(learned_);
  const double hi = task_.levels().gate(step.t + 1);
  step.log_threshold = PassLevel(step.t + 1);
  step.threshold = task_.support().FromLog(step.t, step.log_threshold);

  v_ = learned_;
  estimate_.FitAt(step.t, AsSpan(z_), fit_);
  stay_level_ = StayLevel(step);
  const bool to_depth = corrections_ < guided::kDepthCorrections;
  const SafetyFilter::Choice choice =
      filter_.Filter(fit_, {step.t + 1, hi}, step.log_threshold, v_, stay_level_, to_depth);
  step.mode = choice.mode;
  step.log_learned = choice.learned;
  stays_ = choice.stays;
  chose_in_ = tracker_;
  if (stays_) {
    tracker_.Wait();
  } else {
    Advance(choice.level);
  }
  moved_to_ = tracker_;
  chosen_ = v_;
  const bool passes = step.mode == Mode::kPolicy && within && v_ == learned_;
  corrections_ = passes ? 0 : corrections_ + 1;
  at_edge_.Add(passes && step.log_g < task_.levels().edge(step.t));
  step.filtered = step.mode == Mode::kPolicy && !passes;
  // A control that passes is unchanged, bit for bit.
  if (!passes) {
    step.change = (v_ - core::AsVector(u) / task_.response().control_unit()).norm();
    core::AsVector(u) = v_ * task_.response().control_unit();
  }
  last_seen_ = seen_;
  ++progress_.controls;
  return step;
}

void GuidedController::Applied(std::span<const double> u) noexcept {
  if (halt_cause() != HaltCause::kNone || progress_.controls == 0) return;
  v_ = core::AsVector(u) / task_.response().control_unit();
  tracker_ = chose_in_;
  const LocalModel model{task_.support(), fit_};
  const double next = model.Level(tracker_.phase() + 1, v_);
  if (stays_) {
    // The action may be rounded, or differ in entries without an effect.
    const double here = model.Level(tracker_.phase(), v_);
    if (here >= stay_level_ - guided::kLeastGain && here > next) return tracker_.Wait();
  }
  Advance(next);
}

void GuidedController::AppliedAsChosen() noexcept {
  if (halt_cause() != HaltCause::kNone || progress_.controls == 0) return;
  tracker_ = moved_to_;
  v_ = chosen_;
}

void GuidedController::Foresee(const GuidedController& present,
                               std::span<const double> x) noexcept {
  *this = present;
  if (halt_cause() == HaltCause::kNone) See(x);
}

bool GuidedController::PassesNext(std::span<const double> control) noexcept {
  if (halt_cause() != HaltCause::kNone) return false;
  Step step = Look();
  if (step.cause == HaltCause::kNone) {
    foreseen_ = core::AsVector(control);
    step = Decide(step, AsSpan(foreseen_));
  }
  if (step.mode == Mode::kPolicy && !step.filtered) {
    // Predicted states do not update the estimate.
    fit_.AddEffect(v_, z_);
    if (stays_ || step.log_learned >= step.log_threshold) return true;
  }
  Stop(step.cause != HaltCause::kNone ? step.cause : HaltCause::kOutsideSupport);
  return false;
}

double GuidedController::PassLevel(int t) const noexcept {
  const double hi = task_.levels().gate(t);
  if (!options_.least_intervention) return hi;
  const double lo = task_.levels().pass(t);
  const double share = (at_edge_.steps() - task_.levels().edge_stay()) / guided::kEdgeRamp;
  return lo + (hi - lo) * std::clamp(share, 0.0, 1.0);
}

double GuidedController::StayLevel(const Step& step) const noexcept {
  const bool may_stay = options_.least_intervention && tracker_.waited() == 0 &&
                        options_.patience > 1 && step.t + 1 < task_.support().num_steps();
  return may_stay ? std::max(step.log_g + guided::kLeastGain, PassLevel(step.t))
                  : std::numeric_limits<double>::infinity();
}

void GuidedController::Advance(double level) noexcept {
  if (level >= 0.0) return tracker_.Advance();
  dz_ = z_;
  fit_.AddEffect(v_, dz_);
  tracker_.Advance(AsSpan(dz_), level, !(level >= -filter_.max_exit_level()));
}

}  // namespace dfr::control
