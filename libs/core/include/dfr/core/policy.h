#pragma once

#include <span>

namespace dfr::core {

/// A policy u = pi(x), learned or scripted. The control loop calls it: Control() must not allocate,
/// lock or throw, and must be safe to call from several threads.
class Policy {
 public:
  virtual ~Policy() = default;

  [[nodiscard]] virtual int state_dim() const noexcept = 0;
  [[nodiscard]] virtual int control_dim() const noexcept = 0;

  /// Writes the control for state `x` (state_dim() entries) at time step `t` to `u`
  /// (control_dim()). Policies of the paper ignore t. Where no control can be given (a non-finite
  /// state, say), all entries of `u` are NaN, which every controller here turns into a halt.
  virtual void Control(int t, std::span<const double> x, std::span<double> u) const noexcept = 0;
};

}  // namespace dfr::core
