#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>

#include "dfr/vision/camera_model.h"
#include "dfr/vision/image_view.h"

namespace dfr::sim {

/// Light and state of the optics.
struct EndoscopeLight {
  double gain = 1.0;  ///< With gain 1, the gauze appears at four fifths of white.
  /// Relative increase in brightness towards +x, +y per unit of (x/z, y/z).
  Eigen::Vector2d gradient = Eigen::Vector2d::Zero();
  double glare = 0.0;  ///< Brightness added at the centre of a bright spot, in [0, 255].
  Eigen::Vector2d glare_at = Eigen::Vector2d::Zero();  ///< (x/z, y/z)
  double blur_px = 0.5;                                ///< Standard deviation of the focus blur.
  double noise = 3.0;  ///< Standard deviation of the noise; white is 255.
};

/// Model of an endoscope's lens, lamp and sensor: converts a pinhole camera's rendering to the
/// endoscope's picture, 8-bit BGR. Stages, in order: distortion, by bilinear look-up in the pinhole
/// picture, whose field of view is as wide as the lens needs; blur; light with vignette and glare;
/// noise.
///
/// Const and thread-safe; copies share the tables. Uses OpenCV, whose number of threads the program
/// sets.
class Endoscope {
 public:
  /// @throws std::invalid_argument if the camera is invalid, or its distortion folds over within
  ///   the image.
  explicit Endoscope(const vision::CameraModel& camera);

  [[nodiscard]] const vision::CameraModel& camera() const noexcept { return camera_; }
  /// Required vertical field of view of the pinhole picture, rad. Both pictures have the same
  /// number of pixels.
  [[nodiscard]] double pinhole_fovy_rad() const noexcept;
  /// Number of bytes of a picture.
  [[nodiscard]] std::size_t image_size() const noexcept;

  /// Writes the endoscope's picture to `bgr`, rows from the top.
  /// @param pinhole_rgb  rendering of a pinhole camera with the same pose, RGB, bottom row first.
  /// @pre both have image_size() bytes.
  void Develop(std::span<const std::uint8_t> pinhole_rgb, const EndoscopeLight& light,
               std::uint64_t noise_seed, std::span<std::uint8_t> bgr) const;

  /// Returns `bgr` as an image for vision.
  [[nodiscard]] vision::ImageView View(const std::uint8_t* bgr) const noexcept;

 private:
  struct Tables;
  [[nodiscard]] static std::shared_ptr<const Tables> MakeTables(const vision::CameraModel& camera);

  vision::CameraModel camera_;
  std::shared_ptr<const Tables> tables_;
};

}  // namespace dfr::sim
