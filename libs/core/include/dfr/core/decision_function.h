#pragma once

#include <span>

namespace dfr::core {

/// The estimated support of the supervisor's states at each time step (Sec. IV-A):
/// B_t = {x : g_t(x) >= 0}.
///
/// Implementations are immutable once made: concurrent calls are safe. Nothing here allocates,
/// locks or throws, so all of it may be called in the control loop.
class DecisionFunction {
 public:
  virtual ~DecisionFunction() = default;

  /// Entries of a state x.
  [[nodiscard]] virtual int state_dim() const noexcept = 0;

  /// How many time steps have an estimate of their own. Times beyond use the last one (the
  /// demonstrations hold their last state), negative ones the first.
  [[nodiscard]] virtual int num_steps() const noexcept = 0;

  /// g_t(x), positive inside. A state with a wrong size or a non-finite entry gives -infinity, so
  /// that a broken sensor reads as outside.
  [[nodiscard]] virtual double Decision(int t, std::span<const double> x) const noexcept = 0;

  /// g_t(x), with its derivative by x written to `gradient` (state_dim() entries). Where g is
  /// -infinity the gradient is zero.
  virtual double Gradient(int t, std::span<const double> x,
                          std::span<double> gradient) const noexcept = 0;

  /// A constant L with |g_t(x) - g_t(y)| <= L |x - y| for all x, y.
  [[nodiscard]] virtual double lipschitz_bound(int t) const noexcept = 0;
};

/// A decision function that also has a log form l_t: the same sign and zero set as g_t, but with a
/// slope that still points back to the support far outside, where g_t is flat.
class LogDecisionFunction : public DecisionFunction {
 public:
  /// l_t(x), with its derivative by x written to `gradient` (state_dim() entries, or none to leave
  /// it out). -infinity, with a zero gradient, where Decision() is.
  virtual double LogDecision(int t, std::span<const double> x,
                             std::span<double> gradient) const noexcept = 0;

  /// g_t of a state at which l_t is `l`: rho_t (e^l - 1). -infinity at -infinity.
  [[nodiscard]] virtual double FromLog(int t, double l) const noexcept = 0;

  /// How far l_t may bend downwards: the smallest known c >= 0 with
  ///   l_t(x + d) >= l_t(x) + d . grad l_t(x) - c |d|^2   for all x, d.
  /// For c > 0 the ball around x + grad l_t(x) / (2 c) of radius R,
  /// R^2 = |grad l_t(x)|^2 / (4 c^2) + l_t(x) / c, therefore lies inside B_t.
  [[nodiscard]] virtual double curvature_bound(int t) const noexcept = 0;
};

}  // namespace dfr::core
