#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

namespace dfr::vision::internal {

struct LinePoint {
  double x = 0.0;
  double y = 0.0;
};

/// Fits y = c0 + c1 x + c2 x^2 by iteratively reweighted least squares with Tukey's weights. Solves
/// for x in units of 0.03 m to keep the normal equations well scaled. Fit() writes the weights, 0
/// for outliers, and returns false if the points do not determine the curve.
class RobustQuadratic {
 public:
  bool Fit(const std::vector<LinePoint>& points, std::vector<double>& weights) noexcept {
    weights.assign(points.size(), 1.0);
    if (!Solve(points, weights)) return false;
    // Outliers bias the first fit: start with a wide scale and narrow it.
    for (const double scale : {2e-3, 1e-3, 5e-4, 3e-4, 3e-4, 3e-4}) {
      for (std::size_t i = 0; i < points.size(); ++i) {
        const double r = (points[i].y - At(points[i].x)) / scale;
        const double w = 1.0 - r * r;
        weights[i] = std::abs(r) < 1.0 ? w * w : 0.0;
      }
      if (!Solve(points, weights)) return false;
    }
    return true;
  }

  [[nodiscard]] double At(double x) const noexcept { return c_[0] + x * (c_[1] + x * c_[2]); }
  [[nodiscard]] double SlopeAt(double x) const noexcept { return c_[1] + 2.0 * c_[2] * x; }
  [[nodiscard]] const Eigen::Vector3d& coefficients() const noexcept { return c_; }

  /// Returns the x of the curve's point nearest to `p`, a few millimetres away; NaN if the curve
  /// bends too much. Newton's method on (x - px) + (f(x) - py) f'(x) = 0, whose derivative stays
  /// positive for a gentle curve.
  [[nodiscard]] double Nearest(const Eigen::Vector2d& p) const noexcept {
    double x = p.x();
    for (int iteration = 0; iteration < 8; ++iteration) {
      const double f = At(x) - p.y();
      const double slope = SlopeAt(x);
      const double derivative = 1.0 + slope * slope + f * 2.0 * c_[2];
      if (!(derivative > 0.1)) return std::numeric_limits<double>::quiet_NaN();
      x -= (x - p.x() + f * slope) / derivative;
    }
    return x;
  }

 private:
  bool Solve(const std::vector<LinePoint>& points, const std::vector<double>& weights) noexcept {
    constexpr double kUnit = 0.03;
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d right = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < points.size(); ++i) {
      if (weights[i] == 0.0) continue;
      const double s = points[i].x / kUnit;
      const Eigen::Vector3d row(1.0, s, s * s);
      normal += weights[i] * row * row.transpose();
      right += weights[i] * points[i].y * row;
    }
    if (!(std::abs(normal.determinant()) > 1e-6)) return false;
    const Eigen::Vector3d c = normal.inverse() * right;
    c_ = {c[0], c[1] / kUnit, c[2] / (kUnit * kUnit)};
    return c_.allFinite();
  }

  Eigen::Vector3d c_ = Eigen::Vector3d::Zero();
};

}  // namespace dfr::vision::internal
