#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/control/guided/response_estimate.h"
#include "dfr/core/decision_function.h"

namespace dfr::control {

inline constexpr int kMaxStepEntries = 256;

/// l_q(z'(v)), the level that a control is predicted to lead to, and its gradient by z'.
struct PredictedLevel {
  double level = 0.0;
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxStepEntries, 1> gradient;
};

/// What is known around one state: the support to keep, and how features answer a control there.
/// Borrows all; valid until the next ResponseEstimate::Compute().
struct LocalModel {
  const core::LogDecisionFunction& support;
  const ResponseEstimate& response;  ///< z' = z + J v + m + s d.
  std::span<const double> z;         ///< Features of the state (support.state_dim() entries).

  /// l_phase(z'), the level that control `v` is predicted to lead to.
  [[nodiscard]] double Level(int phase, const Eigen::VectorXd& v) const noexcept;
  /// The same with its gradient.
  [[nodiscard]] PredictedLevel Predict(int phase, const Eigen::VectorXd& v) const noexcept;
};

/// Where a control is to lead.
struct StepTarget {
  int phase = 0;       ///< q: l_q is to be raised ...
  double level = 0.0;  ///< ... to this, and no further.
};

/// What a control has to respect.
struct StepLimits {
  Eigen::VectorXd control = {};  ///< |v_i| is at most entry i; empty: no limit.
  int iterations = 6;            ///< Gradients of l that one call may ask for, >= 0.

  /// Keeps `v` within `control`.
  void Limit(Eigen::VectorXd& v) const noexcept {
    if (control.size() > 0) v = v.cwiseMax(-control).cwiseMin(control);
  }
};

/// Limits of v = u / `unit` from limits of u: one for all `dim` entries, or one each.
/// @throws std::invalid_argument if there is another number of them.
[[nodiscard]] StepLimits ScaledLimits(std::span<const double> limits, int dim, double unit,
                                      int iterations);
/// @throws std::invalid_argument if one is negative or NaN.
void CheckLimits(std::span<const double> limits);

/// Raises the predicted level l_q(z + J v) towards `target.level` by the smallest steps that surely
/// do: with d = J' grad l and c the support's curvature bound, Jensen's inequality gives
///   l(z + J (v + s d)) >= l(z + J v) + s |d|^2 - s^2 c |J d|^2,
/// whose largest gain is at s = |d|^2 / (2 c |J d|^2). A step goes there, or as far as surely
/// reaches the level. `v` is changed in place, and returned is the level it is predicted to reach:
/// never less than that of the `v` given.
///
/// A pure function: called with the demonstrated control, then with the learned one.
/// `v` within the limits stays within. Neither allocates nor throws; at most kMaxStepEntries
/// features and as many controls.
double AscendSupport(const LocalModel& model, const StepTarget& target, const StepLimits& limits,
                     Eigen::VectorXd& v) noexcept;
/// The same where model.Predict(target.phase, v) is known: `there`, which becomes that of the new
/// `v`.
double AscendSupport(const LocalModel& model, const StepTarget& target, const StepLimits& limits,
                     Eigen::VectorXd& v, PredictedLevel& there) noexcept;

}  // namespace dfr::control
