#include "dfr/control/certified/certificate.h"

#include <algorithm>
#include <cmath>

#include "dfr/core/matrix.h"

namespace dfr::control {

SafeBall ComputeSafeBall(const core::LogDecisionFunction& support, int t, std::span<const double> z,
                         std::span<double> shift, double level) noexcept {
  const double l = support.LogDecision(t, z, shift) + level;
  const double c = support.curvature_bound(t);
  double square = 0.0;
  for (double& entry : shift) {
    entry /= 2.0 * c;
    square += entry * entry;
  }
  SafeBall ball;
  ball.shift_norm = std::sqrt(square);
  ball.radius = l >= 0.0 ? std::sqrt(square + l / c) : -1.0;
  return ball;
}

double LargestShare(const SafeBall& ball, std::span<const double> shift, std::span<const double> a,
                    double e) noexcept {
  if (!(ball.radius >= ball.shift_norm)) return 0.0;
  // |s a - shift|^2 <= (radius - s e)^2 is p s^2 - 2 q s + r <= 0 with r <= 0. It holds from s = 0
  // to the smallest positive root, which is computed in a form without cancellation.
  double p = -e * e;
  double q = -ball.radius * e;
  for (std::size_t i = 0; i < a.size(); ++i) {
    p += a[i] * a[i];
    q += a[i] * shift[i];
  }
  const double r = (ball.shift_norm - ball.radius) * (ball.shift_norm + ball.radius);
  double share = 1.0;
  if (e > 0.0) share = std::min(share, ball.radius / e);
  const double discriminant = q * q - p * r;
  if (discriminant >= 0.0) {
    const double root = std::sqrt(discriminant);
    if (q >= 0.0 && p > 0.0) {
      share = std::min(share, (root + q) / p);
    } else if (root > q) {
      share = std::min(share, -r / (root - q));
    }
  }
  // A margin for rounding: a scaled control must stay in the ball.
  constexpr double kRounding = 1e-9;
  return share < 1.0 ? std::max(0.0, share * (1.0 - kRounding)) : 1.0;
}

}  // namespace dfr::control
