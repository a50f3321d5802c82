#include "scene/gauze_line.h"

#include <array>
#include <cmath>

namespace dfr::sim::internal {

GauzeLine::Nearest GauzeLine::NearestTo(const Eigen::Vector2d& p) const noexcept {
  // Newton on half the derivative of the squared distance. Within the radius of curvature of a
  // gentle line (80 mm or more), the derivative of this function is positive, and nearby starts
  // converge.
  double x = p.x();
  for (int i = 0; i < 20; ++i) {
    const double slope = SlopeAt(x);
    const double f = At(x) - p.y();
    const double step = (x - p.x() + f * slope) / (1.0 + slope * slope + 2.0 * f * c[2]);
    x -= step;
    if (std::abs(step) < 1e-12) break;
  }
  const double slope = SlopeAt(x);
  return {x, ((p.y() - At(x)) - slope * (p.x() - x)) / std::sqrt(1.0 + slope * slope)};
}

double GauzeLine::Length(double a, double b) const noexcept {
  // Gauss-Legendre, five points: exact to rounding for the square root of a gentle polynomial.
  constexpr std::array<double, 3> kNode = {0.0, 0.5384693101056831, 0.9061798459386640};
  constexpr std::array<double, 3> kWeight = {0.5688888888888889, 0.4786286704993665,
                                             0.2369268850561891};
  const double middle = 0.5 * (a + b);
  const double half = 0.5 * (b - a);
  double sum = kWeight[0] * std::hypot(1.0, SlopeAt(middle));
  for (std::size_t i = 1; i < 3; ++i) {
    sum += kWeight[i] * (std::hypot(1.0, SlopeAt(middle + half * kNode[i])) +
                         std::hypot(1.0, SlopeAt(middle - half * kNode[i])));
  }
  return half * sum;
}

double GauzeLine::Along(double a, double length) const noexcept {
  double x = a + length;
  for (int i = 0; i < 10; ++i) x -= (Length(a, x) - length) / std::hypot(1.0, SlopeAt(x));
  return x;
}

}  // namespace dfr::sim::internal
