#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "dfr/control/response/local_fit.h"
#include "dfr/core/decision_function.h"

namespace dfr::control {

inline constexpr int kMaxStepEntries = 256;

/// l_q(z'(v)), the predicted level of a control, and its gradient with respect to z'.
struct PredictedLevel {
  double level = 0.0;
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxStepEntries, 1> gradient;
};

/// Local model at one state: the support and the response of features to a control. Borrows its
/// parts.
struct LocalModel {
  const core::LogDecisionFunction& support;
  const LocalFit& response;  ///< z' = z + J v + m + s d.
  /// Features of the state (support.state_dim() entries).
  std::span<const double> z = response.z();

  /// Returns l_phase(z'), the predicted level of control `v`.
  [[nodiscard]] double Level(int phase, const Eigen::VectorXd& v) const noexcept;
  /// Returns the predicted level of control `v`, with its gradient.
  [[nodiscard]] PredictedLevel Predict(int phase, const Eigen::VectorXd& v) const noexcept;
};

/// Target of a control.
struct StepTarget {
  int phase = 0;       ///< Phase q of the support.
  double level = 0.0;  ///< Level to which l_q is raised.
};

/// Limits of a step.
struct StepLimits {
  Eigen::VectorXd control = {};  ///< |v_i| is at most entry i; empty: no limit.
  int iterations = 6;            ///< Maximum number of gradients of l per call, >= 0.
  /// Response::values(); empty: all entries have many values. Steps skip entries with few values.
  std::vector<std::vector<double>> values = {};

  /// Clamps `v` to `control`. Returns true if this changed an entry.
  bool Limit(Eigen::VectorXd& v) const noexcept {
    if (control.size() == 0) return false;
    const bool beyond = (v.array().abs() > control.array()).any();
    v = v.cwiseMax(-control).cwiseMin(control);
    return beyond;
  }
  /// Returns true if entry `k` has few values.
  [[nodiscard]] bool HasFewValues(Eigen::Index k) const noexcept {
    return !values.empty() && !values[static_cast<std::size_t>(k)].empty();
  }
  /// Moves each entry with few values to the nearest of these values, the lower of two equally
  /// near ones.
  void Snap(Eigen::VectorXd& v) const noexcept;
};

/// Returns limits of v = u / `unit` from limits of u: one limit for all `dim` entries, or one per
/// entry.
/// @throws std::invalid_argument for another number of limits.
[[nodiscard]] StepLimits ScaledLimits(std::span<const double> limits, int dim, double unit,
                                      int iterations);

/// Raises the predicted level l_q(z + J v) towards `target.level` by minimal steps with a
/// guaranteed gain. With d = J' grad l and the support's curvature bound c, Jensen's inequality
/// gives
///   l(z + J (v + s d)) >= l(z + J v) + s |d|^2 - s^2 c |J d|^2,
/// whose maximum is at s = |d|^2 / (2 c |J d|^2). A step ends there, or where the bound reaches the
/// level. Changes `v` in place and returns its predicted level, which is never less than the level
/// of the given `v`. Entries with few values stay unchanged.
///
/// This is a pure function. If `v` is within the limits, the result is too. Neither allocates nor
/// throws. Supports at most kMaxStepEntries features and control entries.
double AscendSupport(const LocalModel& model, const StepTarget& target, const StepLimits& limits,
                     Eigen::VectorXd& v) noexcept;
/// Overload for a known `there` = model.Predict(target.phase, v). Updates `there` for the new `v`.
double AscendSupport(const LocalModel& model, const StepTarget& target, const StepLimits& limits,
                     Eigen::VectorXd& v, PredictedLevel& there) noexcept;

/// A probe of one direction of control.
struct Probe {
  double size = 0.0;  ///< Length before StepLimits::Limit(); 0: there is no probe.
  int phase = 0;      ///< The probe has the sign with the higher predicted level in this phase.
  bool keeps_sign = false;  ///< Takes the sign of LocalFit::LeastExcitedDirection() instead.
};

/// Replaces `v` by a probe of the least excited direction of control at `fit`, within `limits`. An
/// entry with few values takes the value nearest to 0.
/// @returns false, with `v` unchanged, if no direction is unknown, or the unknown direction
/// consists mostly of entries that are fixed. Neither allocates nor throws.
bool TakeProbe(const core::LogDecisionFunction& support, LocalFit& fit, const StepLimits& limits,
               const Probe& probe, Eigen::VectorXd& v) noexcept;

}  // namespace dfr::control
