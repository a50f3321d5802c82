#pragma once

#include <Eigen/Core>

namespace dfr::sim::internal {

/// The drawn line in the gauze's frame: y = c0 + c1 x + c2 x^2, m.
struct GauzeLine {
  Eigen::Vector3d c = Eigen::Vector3d::Zero();

  [[nodiscard]] double At(double x) const noexcept { return c[0] + x * (c[1] + x * c[2]); }
  [[nodiscard]] double SlopeAt(double x) const noexcept { return c[1] + 2.0 * c[2] * x; }

  struct Nearest {
    double x = 0.0;         ///< x of the nearest point.
    double distance = 0.0;  ///< Signed: positive if the point is to the left (+y) of the line.
  };
  [[nodiscard]] Nearest NearestTo(const Eigen::Vector2d& p) const noexcept;

  /// Returns the length along the line from x = a to x = b, negative if b < a.
  [[nodiscard]] double Length(double a, double b) const noexcept;
  /// Returns the x with Length(a, x) = `length`.
  [[nodiscard]] double Along(double a, double length) const noexcept;
};

}  // namespace dfr::sim::internal
