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

}  // namespace dfr::core
