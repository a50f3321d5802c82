#include "dfr/control/guided/support_step.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "dfr/control/constants.h"
#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "small_system.h"

namespace dfr::control {
namespace {

// Holds up to kMaxStepEntries entries on the stack.
using Vector = decltype(PredictedLevel::gradient);

double LevelAfter(const LocalModel& model, int phase, const Eigen::VectorXd& v, Vector& there,
                  std::span<double> gradient) noexcept {
  there = core::AsVector(model.z);
  model.response.AddEffect(v, there);
  return model.support.LogDecision(phase, {there.data(), model.z.size()}, gradient);
}

// Implements AscendSupport(). Unless `needs_gradient`, computes no gradient after a step that
// should reach the level, because most of these steps are the last.
double Ascend(const LocalModel& model, const StepTarget& target, const StepLimits& limits,
              Eigen::VectorXd& v, PredictedLevel& there, bool needs_gradient) noexcept {
  const Eigen::MatrixXd& j = model.response.jacobian();
  const auto n = static_cast<Eigen::Index>(model.z.size());
  assert(n <= kMaxStepEntries && v.size() <= kMaxStepEntries &&
         (limits.control.size() == 0 || limits.control.size() == v.size()) &&
         there.gradient.size() == n);
  const double curvature = model.support.curvature_bound(target.phase);
  Vector after(n);
  Vector next_gradient(n);
  Vector d(v.size());
  Vector effect(n);
  Vector before(v.size());
  for (int i = 0; i < limits.iterations && there.level < target.level; ++i) {
    d.noalias() = j.transpose().lazyProduct(there.gradient);
    // Removes the part of the direction that the limits forbid.
    for (Eigen::Index k = 0; k < v.size(); ++k) {
      if (limits.HasFewValues(k)) d[k] = 0.0;
    }
    for (Eigen::Index k = 0; k < limits.control.size(); ++k) {
      if ((v[k] >= limits.control[k] && d[k] > 0.0) || (v[k] <= -limits.control[k] && d[k] < 0.0)) {
        d[k] = 0.0;
      }
    }
    const double slope = d.squaredNorm();
    internal::ForSumsOfColumns(
        j.data(), n, n, d.data(), d.size(),
        [&](Eigen::Index k, const auto& sums) { internal::Part(effect.data(), k, sums) = sums; });
    const double bend = curvature * effect.squaredNorm();
    if (!(slope > 0.0)) break;
    // A step s gains at least slope s - bend s^2, with the maximum at `best`.
    const double best = slope / (2.0 * bend);
    const double gain = slope * best / 2.0;
    const double missing = target.level - there.level;
    if (!(gain >= std::min(guided::kLeastGain, missing))) break;
    // If the step reaches the level before `best`, it ends at the root. This form has no
    // cancellation and also holds without curvature.
    const double step =
        gain > missing ? 2.0 * missing / (slope * (1.0 + std::sqrt(1.0 - missing / gain))) : best;
    before = v;
    v += step * d;
    limits.Limit(v);
    const bool ends = !needs_gradient && (gain > missing || i + 1 == limits.iterations);
    const std::span<double> gradient(next_gradient.data(), model.z.size());
    const double reached =
        LevelAfter(model, target.phase, v, after, ends ? std::span<double>() : gradient);
    if (reached <= there.level) {
      // Only clamping to a limit can prevent a rise of the level.
      v = before;
      break;
    }
    const double gained = reached - there.level;
    there.level = reached;
    const bool last = gained < guided::kLeastGain;
    if (ends && !last && reached < target.level && i + 1 < limits.iterations) {
      LevelAfter(model, target.phase, v, after, gradient);
    }
    there.gradient.swap(next_gradient);
    if (last) break;
  }
  return there.level;
}

// Writes a probe along `direction`, or against it.
void Aim(const StepLimits& limits, const Vector& direction, double size,
         Eigen::VectorXd& v) noexcept {
  v = size * direction;
  limits.Snap(v);
  limits.Limit(v);
}

}  // namespace

StepLimits ScaledLimits(std::span<const double> limits, int dim, double unit, int iterations) {
  if (limits.size() == 1) return {Eigen::VectorXd::Constant(dim, limits[0] / unit), iterations};
  DFR_THROW_UNLESS(static_cast<int>(limits.size()) == dim,
                   "control_limit has " << limits.size() << " entries, but controls have " << dim);
  return {core::AsVector(limits) / unit, iterations};
}

void StepLimits::Snap(Eigen::VectorXd& v) const noexcept {
  for (std::size_t k = 0; k < values.size(); ++k) {
    if (values[k].empty()) continue;
    double& entry = v[static_cast<Eigen::Index>(k)];
    double nearest = values[k][0];
    for (const double value : values[k]) {
      if (std::abs(value - entry) < std::abs(nearest - entry)) nearest = value;
    }
    entry = nearest;
  }
}

double LocalModel::Level(int phase, const Eigen::VectorXd& v) const noexcept {
  Vector there;
  return LevelAfter(*this, phase, v, there, {});
}

PredictedLevel LocalModel::Predict(int phase, const Eigen::VectorXd& v) const noexcept {
  Vector there;
  PredictedLevel predicted;
  predicted.gradient.resize(static_cast<Eigen::Index>(z.size()));
  predicted.level = LevelAfter(*this, phase, v, there, {predicted.gradient.data(), z.size()});
  return predicted;
}

double AscendSupport(const LocalModel& model, const StepTarget& target, const StepLimits& limits,
                     Eigen::VectorXd& v) noexcept {
  PredictedLevel there = model.Predict(target.phase, v);
  return Ascend(model, target, limits, v, there, /*needs_gradient=*/false);
}

double AscendSupport(const LocalModel& model, const StepTarget& target, const StepLimits& limits,
                     Eigen::VectorXd& v, PredictedLevel& there) noexcept {
  return Ascend(model, target, limits, v, there, /*needs_gradient=*/true);
}

bool TakeProbe(const core::LogDecisionFunction& support, LocalFit& fit, const StepLimits& limits,
               const Probe& probe, Eigen::VectorXd& v) noexcept {
  Vector direction(v.size());
  const std::span<double> entries(direction.data(), static_cast<std::size_t>(v.size()));
  if (probe.size == 0.0 ||
      fit.LeastExcitedDirection(entries, guided::kUnknown) <= guided::kUnknown) {
    return false;
  }
  for (Eigen::Index k = 0; k < v.size(); ++k) {
    const bool fixed = limits.control.size() > 0 && limits.control[k] == 0.0;
    if (fixed || limits.HasFewValues(k)) direction[k] = 0.0;
  }
  if (direction.squaredNorm() < guided::kLeastProbe) return false;
  Aim(limits, direction, probe.size, v);
  if (probe.keeps_sign) return true;
  const LocalModel model{support, fit};
  const double level = model.Level(probe.phase, v);
  Aim(limits, direction, -probe.size, v);
  if (!(model.Level(probe.phase, v) > level)) Aim(limits, direction, probe.size, v);
  return true;
}

}  // namespace dfr::control
