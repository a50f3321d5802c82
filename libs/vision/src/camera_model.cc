#include "dfr/vision/camera_model.h"

#include <Eigen/LU>
#include <cmath>
#include <limits>

#include "dfr/core/contract.h"

namespace dfr::vision {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Returns the distorted point; computes its derivative with respect to the undistorted point.
Eigen::Vector2d Distort(const std::array<double, 5>& k, const Eigen::Vector2d& n,
                        Eigen::Matrix2d* derivative) noexcept {
  const double x = n.x();
  const double y = n.y();
  const double r2 = x * x + y * y;
  const double radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  if (derivative != nullptr) {
    const double slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4]));  // 2 d(radial) / d(r2)
    (*derivative)(0, 0) = radial + slope * x * x + 2.0 * k[2] * y + 6.0 * k[3] * x;
    (*derivative)(0, 1) = slope * x * y + 2.0 * k[2] * x + 2.0 * k[3] * y;
    (*derivative)(1, 0) = (*derivative)(0, 1);
    (*derivative)(1, 1) = radial + slope * y * y + 6.0 * k[2] * y + 2.0 * k[3] * x;
  }
  return {x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x),
          y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y};
}

}  // namespace

void CameraModel::Check() const {
  DFR_THROW_UNLESS(width > 0 && height > 0,
                   "camera: the size must be positive, not " << width << " x " << height);
  DFR_THROW_UNLESS(
      std::isfinite(fx) && fx > 0 && std::isfinite(fy) && fy > 0,
      "camera: the focal lengths must be positive and finite, not " << fx << " and " << fy);
  DFR_THROW_UNLESS(std::isfinite(cx) && std::isfinite(cy),
                   "camera: the principal point is not finite: " << cx << ", " << cy);
  for (double k : distortion) {
    DFR_THROW_UNLESS(std::isfinite(k), "camera: a distortion coefficient is not finite");
  }
}

Eigen::Vector2d CameraModel::ToPixel(const Eigen::Vector2d& normalized) const noexcept {
  const Eigen::Vector2d d = Distort(distortion, normalized, nullptr);
  return {fx * d.x() + cx, fy * d.y() + cy};
}

Eigen::Vector2d CameraModel::Project(const Eigen::Vector3d& p_cam) const noexcept {
  if (!(p_cam.z() > 0.0)) return {kNaN, kNaN};
  return ToPixel(p_cam.head<2>() / p_cam.z());
}

Eigen::Vector2d CameraModel::ToNormalized(const Eigen::Vector2d& pixel) const noexcept {
  const Eigen::Vector2d wanted((pixel.x() - cx) / fx, (pixel.y() - cy) / fy);
  Eigen::Vector2d n = wanted;
  for (int iteration = 0; iteration < 20; ++iteration) {
    Eigen::Matrix2d derivative;
    const Eigen::Vector2d error = Distort(distortion, n, &derivative) - wanted;
    const double determinant = derivative.determinant();
    if (!(determinant > 1e-6)) return {kNaN, kNaN};  // the image folds over here
    const Eigen::Vector2d step = derivative.inverse() * error;
    n -= step;
    if (step.squaredNorm() < 1e-20) return n;
  }
  return {kNaN, kNaN};
}

}  // namespace dfr::vision
