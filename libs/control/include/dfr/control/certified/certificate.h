#pragma once

#include <span>

#include "dfr/core/decision_function.h"

namespace dfr::control {

/// What a certified controller trusts, beyond "no B_t meets the constraints": |dz - J u| <= eps
/// |u|. With the ball of core::LogDecisionFunction::curvature_bound() around the state z, or around
/// the predicted state z + J u, that says where the next state is: the better J is, the larger the
/// steps that pass.
struct Certificate {
  double direction_error = 0.0;  ///< eps > 0, in feature units per unit of control.
  /// eta >= 0: what is certified is that the next state is in B_t(eta) = {z : l_t(z) >= -eta} for
  /// some t near. What supervisors do is inside with a probability that eta decides; it must be
  /// known of B_t(eta) that it meets no constraint.
  double level = 0.0;
  /// delta >= 0: the features of an observed state are this near to those of the true one.
  double state_error = 0.0;
};

/// The ball inside B_t(eta) around which l_t cannot fall below -eta, seen from z:
/// {z + d : |d - shift| <= radius}, shift = grad l / (2 c), radius^2 = |shift|^2 + (l + eta) / c.
struct SafeBall {
  double radius = 0.0;      ///< Negative where l < -eta: there is no ball.
  double shift_norm = 0.0;  ///< |shift|
  /// How far any change of state may go, whatever its direction.
  [[nodiscard]] double worst_radius() const noexcept { return radius - shift_norm; }
};

/// The ball at z, its `shift` written out (state_dim() entries), for eta = `level`. Never
/// allocates.
SafeBall ComputeSafeBall(const core::LogDecisionFunction& support, int t, std::span<const double> z,
                         std::span<double> shift, double level = 0.0) noexcept;

/// The largest s in [0, 1] with |s a - shift| + s e <= radius: the share of a control that moves
/// the features by `a`, give or take `e`, which provably stays in the ball. 0 where there is none.
[[nodiscard]] double LargestShare(const SafeBall& ball, std::span<const double> shift,
                                  std::span<const double> a, double e) noexcept;

}  // namespace dfr::control
