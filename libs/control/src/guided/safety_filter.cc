#include "dfr/control/guided/safety_filter.h"

#include <algorithm>
#include <limits>

#include "dfr/control/constants.h"
#include "dfr/core/matrix.h"

namespace dfr::control {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
// Target level just inside the support, with a margin for rounding.
constexpr double kInside = 1e-6;

}  // namespace

SafetyFilter::SafetyFilter(const TaskView& task, const GuidedOptions& options)
    : task_(task),
      limits_(Limits(options, task.response().control_dim(), task.response().control_unit())),
      max_exit_level_(
          std::min(options.max_exit_ratio * task.levels().slack(), guided::kMaxExitLevel)),
      probe_size_(options.probe_size),
      demonstrates_(options.demonstrated),
      pass_depth_(options.least_intervention ? std::min(task.levels().pass_depth(), max_exit_level_)
                                             : 0.0),
      shallow_depth_(std::min({pass_depth_, guided::kShallowDepth * max_exit_level_,
                               task.levels().prediction_error()})),
      least_(options.least_intervention),
      disturbed_(options.disturbance_model.active()),
      trial_(Eigen::VectorXd::Zero(task.response().control_dim())),
      demonstrated_(trial_),
      learned_(trial_),
      from_(trial_) {
  limits_.values = task.response().values();
}

SafetyFilter::Choice SafetyFilter::Filter(LocalFit& fit, const StepTarget& target,
                                          double pass_level, Eigen::VectorXd& v, double stay_level,
                                          bool to_depth) noexcept {
  const LocalModel model{task_.support(), fit};
  const double learned = model.Level(target.phase, v);
  Choice choice{Mode::kPolicy, learned, learned};
  if (!(learned >= pass_level)) {
    if (stay_level < kInfinity) {
      const double here = model.Level(target.phase - 1, v);
      if (here >= stay_level && here > learned) return {Mode::kPolicy, learned, learned, true};
    }
    const bool near = to_depth && learned >= pass_level - pass_depth_ && Rests(fit);
    if (near && (learned >= pass_level - shallow_depth_ || v.norm() <= guided::kResting)) {
      return choice;
    }
    learned_ = v;
    choice = Correct(fit, model, target, v);
    choice.learned = learned;
    // A correction that does not end inside is no better than a control that ends nearby.
    if ((near && choice.level < 0.0) || Idle(fit, choice, target, pass_level, v)) {
      v = learned_;
      return {Mode::kPolicy, learned, learned};
    }
  }
  if (Probe(fit, model, target, v, choice.level)) choice.mode = Mode::kProbe;
  return choice;
}

// Returns true if a change is not worth making: the changed control would still not pass, gains at
// most the difference between gate level and pass level, and differs little from the learned
// control. A control that would leave the support is changed if the changed one stays inside. In a
// world at rest, a larger change counts as small if the learned control does not lower the level.
// If it does, the losses of several steps would add up.
bool SafetyFilter::Idle(const LocalFit& fit, const Choice& choice, const StepTarget& target,
                        double pass_level, const Eigen::VectorXd& v) const noexcept {
  const double margin = target.level - pass_level;
  if (!(choice.level < pass_level && margin > 0.0 && choice.learned >= choice.level - margin)) {
    return false;
  }
  if (choice.level >= 0.0 && choice.learned < 0.0) return false;
  const double change = (v - learned_).squaredNorm();
  if (change <= guided::kIdle * guided::kIdle) return true;
  return change <= guided::kIdleAtRest * guided::kIdleAtRest && Rests(fit) &&
         choice.learned >= task_.support().LogDecision(target.phase - 1, fit.z(), {});
}

bool SafetyFilter::Rests(const LocalFit& fit) const noexcept {
  const double effect = fit.jacobian().squaredNorm() / static_cast<double>(fit.jacobian().cols());
  // Without a known effect, nothing shows that the world rests.
  return !disturbed_ && effect > 0.0 &&
         fit.drift().squaredNorm() <= guided::kRestDrift * guided::kRestDrift * effect;
}

bool SafetyFilter::KeepSigns(const Eigen::VectorXd& other, Eigen::VectorXd& v) const noexcept {
  bool changed = false;
  for (Eigen::Index k = 0; k < v.size(); ++k) {
    const double least = std::min(std::abs(from_[k]), std::abs(other[k]));
    const bool shared = least > guided::kClearSign && from_[k] * other[k] > 0.0;
    if (!shared || !(v[k] * from_[k] < 0.0)) continue;
    v[k] = std::copysign(least, from_[k]);
    changed = true;
  }
  return changed;
}

// AscendSupport() extrapolates J. An entry moves less if demonstrations disagree on its effect, or
// never make large movements nearby. Farther outside, a recovery may need larger ones.
double SafetyFilter::Raise(LocalFit& fit, const LocalModel& model, const StepTarget& target,
                           const Eigen::VectorXd* other, Eigen::VectorXd& v) noexcept {
  from_ = v;
  const double level = AscendSupport(model, target, limits_, v);
  if (!least_) return level;
  bool changed = level < 0.0 && other != nullptr && !Rests(fit) && KeepSigns(*other, v);
  bool near = false;
  for (Eigen::Index k = 0; k < v.size(); ++k) {
    const double most = guided::kLocalReach * fit.DemonstratedSize(k);
    const double limited = std::clamp(v[k], std::min(from_[k], -most), std::max(from_[k], most));
    if (limited == v[k]) continue;
    // Evaluates the support once, and only if an entry is beyond its limit.
    near = near || task_.support().LogDecision(target.phase - 1, fit.z(), {}) >= -pass_depth_;
    if (!near) break;
    changed = true;
    v[k] = limited;
  }
  for (Eigen::Index k = 0; k < v.size(); ++k) {
    const double step = v[k] - from_[k];
    if (std::abs(step) <= guided::kLeastHedged) continue;
    v[k] = from_[k] + fit.Agreement(k) * step;
    changed = true;
  }
  if (!changed) return level;
  const double before = model.Level(target.phase, from_);
  const double after = model.Level(target.phase, v);
  if (after > before) return after;
  // The changes of several entries may raise the level only in combination.
  v = from_;
  return before;
}

SafetyFilter::Choice SafetyFilter::Correct(LocalFit& fit, const LocalModel& model,
                                           const StepTarget& target, Eigen::VectorXd& v) noexcept {
  const int next = target.phase;
  // No support follows the last support: a target deep inside it would stop the task there.
  const bool last = next >= model.support.num_steps();
  const bool known = demonstrates_ && fit.NominalControl(trial_);
  double demonstrated = -kInfinity;
  if (known) {
    limits_.Snap(trial_);
    limits_.Limit(trial_);
    demonstrated_ = trial_;
    demonstrated = Raise(fit, model, {next, last ? kInside : target.level}, &learned_, trial_);
    if (demonstrated >= 0.0) {
      v = trial_;
      return {Mode::kRecovery, demonstrated};
    }
  }
  const double filtered = Raise(fit, model, target, known ? &demonstrated_ : nullptr, v);
  if (filtered >= 0.0) return {Mode::kPolicy, filtered};
  const double raised = std::max(demonstrated, filtered);
  if (known && (last || raised < -max_exit_level_)) {
    // Far outside, J is an extrapolation, and the demonstrated control continues the task. Where a
    // raise would nearly lead back into the support, the demonstrated control might lead away from
    // the support.
    const double plain = model.Level(next, demonstrated_);
    if (!(raised > guided::kWorthRaising * plain)) {
      v = demonstrated_;
      return {Mode::kRecovery, plain};
    }
  }
  if (demonstrated <= filtered) return {Mode::kPolicy, filtered};
  v = trial_;
  return {Mode::kRecovery, demonstrated};
}

bool SafetyFilter::Probe(LocalFit& fit, const LocalModel& model, const StepTarget& target,
                         Eigen::VectorXd& v, double& level) noexcept {
  // A control that is predicted to end inside needs no probe, except to estimate a disturbance.
  if (level >= (disturbed_ ? target.level : 0.0)) return false;
  // Under a disturbance the direction already has the more informative sign.
  const control::Probe probe{probe_size_, target.phase, /*keeps_sign=*/disturbed_};
  if (!TakeProbe(task_.support(), fit, limits_, probe, v)) return false;
  level = model.Level(target.phase, v);
  return true;
}

}  // namespace dfr::control
