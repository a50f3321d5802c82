#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>

#include "dfr/vision/camera_model.h"
#include "dfr/vision/image_view.h"

namespace dfr::sim {

/// The light and the state of the optics.
struct EndoscopeLight {
  double gain = 1.0;  ///< 1 shows the gauze at four fifths of white.
  Eigen::Vector2d gradient = Eigen::Vector2d::Zero();  ///< Brighter towards +x, +y: share per unit
                                                       ///< of (x/z, y/z).
  double glare = 0.0;  ///< Added in the middle of a bright spot, of 255.
  Eigen::Vector2d glare_at = Eigen::Vector2d::Zero();  ///< (x/z, y/z)
  double blur_px = 0.5;                                ///< Standard deviation of the focus' blur.
  double noise = 3.0;                                  ///< Standard deviation, of 255.
};

/// An endoscope's lens, lamp and sensor: makes what it delivers, 8-bit BGR, of a pinhole camera's
/// rendering. Stages, in order: distortion, by bilinear look-up in the pinhole picture, whose field
/// of view is just as wide as the lens needs; blur; light with vignette and glare; noise.
///
/// Const and thread-safe; copies share the tables. Uses OpenCV, whose number of threads is the
/// program's to set.
class Endoscope {
 public:
  /// @throws std::invalid_argument if the camera makes no sense, or its distortion folds over
  ///   within the image.
  explicit Endoscope(const vision::CameraModel& camera);

  [[nodiscard]] const vision::CameraModel& camera() const noexcept { return camera_; }
  /// The vertical field of view that the pinhole picture must have, rad. It is as many pixels wide
  /// and high as the camera's.
  [[nodiscard]] double pinhole_fovy_rad() const noexcept;
  /// Bytes of a picture.
  [[nodiscard]] std::size_t image_size() const noexcept;

  /// Writes the endoscope's picture to `bgr`, rows from the top.
  /// @param pinhole_rgb  what a pinhole camera at the same place sees, RGB, bottom row first.
  /// @pre both have image_size() bytes.
  void Develop(std::span<const std::uint8_t> pinhole_rgb, const EndoscopeLight& light,
               std::uint64_t noise_seed, std::span<std::uint8_t> bgr) const;

  /// `bgr` as what vision takes.
  [[nodiscard]] vision::ImageView View(const std::uint8_t* bgr) const noexcept;

 private:
  struct Tables;
  vision::CameraModel camera_;
  std::shared_ptr<const Tables> tables_;
};

}  // namespace dfr::sim
