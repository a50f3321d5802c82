#pragma once

#include <span>

namespace dfr::core {

/// A policy u = pi(x), learned or scripted. The control loop calls Control(): it must not allocate,
/// lock or throw, and must be safe to call from several threads.
class Policy {
 public:
  virtual ~Policy() = default;

  [[nodiscard]] virtual int state_dim() const noexcept = 0;
  [[nodiscard]] virtual int control_dim() const noexcept = 0;

  /// Writes the control for state `x` (state_dim() entries) at time step `t` to `u`
  /// (control_dim()). The paper's policies ignore t. If no control exists (for example, for a
  /// non-finite state), all entries of `u` are NaN, and every controller in this library halts.
  virtual void Control(int t, std::span<const double> x, std::span<double> u) const noexcept = 0;
};

}  // namespace dfr::core
