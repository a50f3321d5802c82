#include "segments.h"

#include <algorithm>

namespace dfr::sim::internal {
namespace {

Point Minus(const Point& a, const Point& b) noexcept {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2]};
}
double Dot(const Point& a, const Point& b) noexcept {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

}  // namespace

double SquaredDistance(const Segment& p, const Segment& q) noexcept {
  // Minimises the convex quadratic |p(s) - q(t)|^2 over the unit square. For a fixed s, the minimum
  // is at a clamped t. Clamping the s of the unconstrained minimum, then the t for this s, then the
  // s for this t gives the constrained minimum.
  const Point u = Minus(p.b, p.a);
  const Point v = Minus(q.b, q.a);
  const Point w = Minus(p.a, q.a);
  const double uu = Dot(u, u);
  const double vv = Dot(v, v);
  const double uv = Dot(u, v);
  const double uw = Dot(u, w);
  const double vw = Dot(v, w);
  const double determinant = uu * vv - uv * uv;
  // Parallel segments have a line of minima along s: any start leads to one.
  double s =
      determinant > 1e-14 * uu * vv ? std::clamp((uv * vw - vv * uw) / determinant, 0.0, 1.0) : 0.0;
  const double t = vv > 0.0 ? std::clamp((uv * s + vw) / vv, 0.0, 1.0) : 0.0;
  if (uu > 0.0) s = std::clamp((uv * t - uw) / uu, 0.0, 1.0);
  double sum = 0.0;
  for (int i = 0; i < 3; ++i) {
    const double d = w[i] + s * u[i] - t * v[i];
    sum += d * d;
  }
  return sum;
}

}  // namespace dfr::sim::internal
