#pragma once

#include <span>

namespace dfr::core {

/// Estimated support of the supervisor's states at each time step (Sec. IV-A): B_t = {x : g_t(x) >=
/// 0}.
///
/// Implementations are immutable after construction: concurrent calls are safe. No member
/// allocates, locks or throws, and all may be called in the control loop.
class DecisionFunction {
 public:
  virtual ~DecisionFunction() = default;

  /// Number of entries of a state x.
  [[nodiscard]] virtual int state_dim() const noexcept = 0;

  /// Number of time steps with an estimate. Later times use the last estimate, because a finished
  /// demonstration stays in its last state. Negative times use the first estimate.
  [[nodiscard]] virtual int num_steps() const noexcept = 0;

  /// Returns g_t(x), positive inside. A state with a wrong size or a non-finite entry gives
  /// -infinity: readings of a broken sensor count as outside.
  [[nodiscard]] virtual double Decision(int t, std::span<const double> x) const noexcept = 0;

  /// Returns g_t(x) and writes its derivative with respect to x to `gradient` (state_dim()
  /// entries). The gradient is zero where g is -infinity.
  virtual double Gradient(int t, std::span<const double> x,
                          std::span<double> gradient) const noexcept = 0;
};

/// A decision function with a log form l_t. It has the same sign and zero set as g_t, but its
/// gradient still points back to the support far outside, where g_t is flat.
class LogDecisionFunction : public DecisionFunction {
 public:
  /// Returns l_t(x) and writes its derivative with respect to x to `gradient` (state_dim() entries,
  /// or empty to skip it). Where Decision() is -infinity, the result is -infinity with a zero
  /// gradient.
  virtual double LogDecision(int t, std::span<const double> x,
                             std::span<double> gradient) const noexcept = 0;

  /// Converts l_t to g_t: rho_t (e^l - 1). Maps -infinity to -infinity.
  [[nodiscard]] virtual double FromLog(int t, double l) const noexcept = 0;

  /// Bound on the downward curvature of l_t: the smallest known c >= 0 with
  ///   l_t(x + d) >= l_t(x) + d . grad l_t(x) - c |d|^2   for all x, d.
  /// Therefore, for c > 0, the ball around x + grad l_t(x) / (2 c) of radius R, R^2 = |grad
  /// l_t(x)|^2 / (4 c^2) + l_t(x) / c, lies inside B_t.
  [[nodiscard]] virtual double curvature_bound(int t) const noexcept = 0;
};

}  // namespace dfr::core
