#pragma once

#include <span>

#include "dfr/core/decision_function.h"

namespace dfr::control {

/// Assumption of a certified controller, in addition to "no B_t contains a state that violates a
/// constraint": |dz - J u| <= eps |u|. Together with core::LogDecisionFunction::curvature_bound(),
/// the assumption bounds l in the next state from below. A smaller eps lets larger steps pass.
struct Certificate {
  double direction_error = 0.0;  ///< eps > 0, in feature units per unit of control.
  /// eta: the certificate states that the next state is in B_t(eta) = {z : l_t(z) >= -eta} for
  /// a nearby t. eta determines the probability that supervisors stay inside. B_t(eta) must contain
  /// no state that violates a constraint.
  double level = 0.0;
  /// delta >= 0: maximum distance between the features of the observed and the true state.
  double state_error = 0.0;
};

/// A ball in which l_t cannot fall below -eta, relative to z:
/// {z + d : |d - shift| <= radius}, shift = grad l / (2 c), radius^2 = |shift|^2 + (l + eta) / c.
struct SafeBall {
  double radius = 0.0;      ///< Negative if l < -eta: the ball is empty.
  double shift_norm = 0.0;  ///< |shift|
  /// Largest change of state allowed in every direction.
  [[nodiscard]] double worst_radius() const noexcept { return radius - shift_norm; }
};

/// Returns the ball at z for eta = `level` and writes its `shift` (state_dim() entries). Never
/// allocates.
SafeBall ComputeSafeBall(const core::LogDecisionFunction& support, int t, std::span<const double> z,
                         std::span<double> shift, double level = 0.0) noexcept;

/// Returns the largest s in [0, 1] with |s a - shift| + s e <= radius, or 0 if there is none. A
/// control that changes the features by `a`, with an error of at most `e`, provably ends in the
/// ball if scaled by s.
[[nodiscard]] double LargestShare(const SafeBall& ball, std::span<const double> shift,
                                  std::span<const double> a, double e) noexcept;

}  // namespace dfr::control
