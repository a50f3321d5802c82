#pragma once

#include <Eigen/Core>
#include <array>

namespace dfr::vision {

/// Pinhole camera with radial and tangential distortion, in OpenCV's convention: x right, y down, z
/// forward, pixel centres at integers, distortion (k1, k2, p1, p2, k3).
///
/// Only Check() allocates or throws.
struct CameraModel {
  int width = 640;   ///< pixels
  int height = 480;  ///< pixels
  double fx = 700.0;
  double fy = 700.0;
  double cx = 319.5;
  double cy = 239.5;
  std::array<double, 5> distortion = {};

  /// @throws std::invalid_argument naming the invalid parameter: sizes and focal lengths must be
  ///   positive, and all entries must be finite.
  void Check() const;

  /// Maps normalised image coordinates (x/z, y/z) to a pixel.
  [[nodiscard]] Eigen::Vector2d ToPixel(const Eigen::Vector2d& normalized) const noexcept;
  /// Returns the pixel of a point in the camera's frame; NaN if it is not in front of the camera.
  [[nodiscard]] Eigen::Vector2d Project(const Eigen::Vector3d& p_cam) const noexcept;
  /// Inverse of ToPixel(), by Newton's method to 1e-10. NaN if it does not converge: no point maps
  /// to this pixel under this distortion.
  [[nodiscard]] Eigen::Vector2d ToNormalized(const Eigen::Vector2d& pixel) const noexcept;

  bool operator==(const CameraModel&) const = default;
};

}  // namespace dfr::vision
