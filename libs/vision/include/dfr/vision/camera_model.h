#pragma once

#include <Eigen/Core>
#include <array>

namespace dfr::vision {

/// A pinhole camera with radial and tangential distortion, in OpenCV's convention: x right, y down,
/// z forward, pixel centres at integers, distortion (k1, k2, p1, p2, k3).
///
/// Nothing here allocates or throws, but for Check().
struct CameraModel {
  int width = 640;   ///< pixels
  int height = 480;  ///< pixels
  double fx = 700.0;
  double fy = 700.0;
  double cx = 319.5;
  double cy = 239.5;
  std::array<double, 5> distortion = {};

  /// @throws std::invalid_argument naming the parameter that makes no camera: sizes and focal
  ///   lengths must be positive, all entries finite.
  void Check() const;

  /// From normalised image coordinates (x/z, y/z) to the pixel.
  [[nodiscard]] Eigen::Vector2d ToPixel(const Eigen::Vector2d& normalized) const noexcept;
  /// The pixel of a point in the camera's frame; NaN if it is not in front of the camera.
  [[nodiscard]] Eigen::Vector2d Project(const Eigen::Vector3d& p_cam) const noexcept;
  /// Inverse of ToPixel(), by Newton's method to 1e-10; NaN where it does not converge, which means
  /// a pixel that this distortion maps nothing to.
  [[nodiscard]] Eigen::Vector2d ToNormalized(const Eigen::Vector2d& pixel) const noexcept;

  bool operator==(const CameraModel&) const = default;
};

}  // namespace dfr::vision
