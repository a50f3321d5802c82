#pragma once

#include <algorithm>
#include <cmath>
#include <span>

#include "dfr/sim/gallery/canvas.h"

namespace dfr::sim::internal {

struct Point {
  double x = 0.0;
  double y = 0.0;
};
inline Point operator+(Point a, Point b) noexcept { return {a.x + b.x, a.y + b.y}; }
inline Point operator-(Point a, Point b) noexcept { return {a.x - b.x, a.y - b.y}; }
inline Point operator*(double s, Point a) noexcept { return {s * a.x, s * a.y}; }
inline double Dot(Point a, Point b) noexcept { return a.x * b.x + a.y * b.y; }
inline double Cross(Point a, Point b) noexcept { return a.x * b.y - a.y * b.x; }
inline double Norm(Point a) noexcept { return std::hypot(a.x, a.y); }
inline Point Turned(Point a, double angle) noexcept {
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  return {c * a.x - s * a.y, s * a.x + c * a.y};
}

struct Disc {
  Point centre;
  double radius = 0.0;
  [[nodiscard]] bool Contains(Point p) const noexcept { return Norm(p - centre) < radius; }
};

/// Axis-aligned box.
struct Box {
  Point low;
  Point high;
  [[nodiscard]] bool Contains(Point p) const noexcept {
    return p.x > low.x && p.x < high.x && p.y > low.y && p.y < high.y;
  }
};

/// Returns the point of the segment from a to b nearest to p.
inline Point Nearest(Point a, Point b, Point p) noexcept {
  const Point d = b - a;
  const double length = Dot(d, d);
  return a + (length > 0.0 ? std::clamp(Dot(p - a, d) / length, 0.0, 1.0) : 0.0) * d;
}

/// Returns the point of a polyline at the distance `ahead` beyond the point nearest to p, or the
/// polyline's end if the end is nearer.
inline Point Ahead(std::span<const Point> path, Point p, double ahead) noexcept {
  std::size_t at = 0;
  Point nearest = path[0];
  for (std::size_t i = 0; i + 1 < path.size(); ++i) {
    const Point q = Nearest(path[i], path[i + 1], p);
    if (i == 0 || Norm(p - q) < Norm(p - nearest)) {
      nearest = q;
      at = i;
    }
  }
  for (; at + 1 < path.size(); ++at) {
    const double rest = Norm(path[at + 1] - nearest);
    if (rest >= ahead) return nearest + (ahead / rest) * (path[at + 1] - nearest);
    ahead -= rest;
    nearest = path[at + 1];
  }
  return nearest;
}

/// Returns `a`, shortened to a norm of at most `longest`.
inline Point Shortened(Point a, double longest) noexcept {
  const double norm = Norm(a);
  return norm > longest ? (longest / norm) * a : a;
}

// Colours of pictures.
inline constexpr Colour kGround{224, 220, 208};
inline constexpr Colour kSolid{96, 92, 88};
inline constexpr Colour kRobot{200, 40, 32};
inline constexpr Colour kObject{32, 72, 184};
inline constexpr Colour kTarget{40, 152, 72};

}  // namespace dfr::sim::internal
