#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "dfr/vision/camera_model.h"
#include "dfr/vision/image_view.h"

namespace dfr::sim {

/// What is before the lens. Camera frame, metres.
struct EndoscopeScene {
  Eigen::Isometry3d p_cam_gauze = Eigen::Isometry3d::Identity();
  /// Marks on the frame that holds the gauze, in the gauze's frame.
  const std::vector<Eigen::Vector2d>* marks_m = nullptr;
  double mark_radius_m = 0.002;
  Eigen::Vector3d line = Eigen::Vector3d::Zero();  ///< y = c0 + c1 x + c2 x^2 in the gauze's frame.
  double line_half_length_m = 0.032;               ///< Drawn for |x| below this; 0: no line.
  double line_width_m = 0.0015;
  /// The tool from its tip on: jaw tips, wrist-yaw axis, wrist-pitch axis, a point up the shaft.
  std::array<Eigen::Vector3d, 4> tool_cam = {};
  double tip_radius_m = 0.001;
};

/// The light and the state of the optics.
struct EndoscopeLight {
  double gain = 1.0;  ///< 1 shows the gauze at four fifths of white.
  Eigen::Vector2d gradient = Eigen::Vector2d::Zero();  ///< Brighter towards +x, +y: share per unit
                                                       ///< of (x/z, y/z).
  double glare = 0.0;  ///< Added in the middle of a bright spot, of 255.
  Eigen::Vector2d glare_at = Eigen::Vector2d::Zero();  ///< (x/z, y/z)
  double blur_px = 0.5;                                ///< Half width of edges, from the focus.
  double noise = 3.0;                                  ///< Standard deviation, of 255.
};

/// An endoscope's pictures, 8-bit BGR.
///
/// The scene is flat gauze, a few round marks and a tool made of tapered rods, so each pixel is
/// computed from its (undistorted) ray and the distances to these shapes; edges are ramps as wide
/// as the blur. That draws exact sub-pixel edges, lens distortion included, in 2-3 ms, where a
/// general renderer (MuJoCo's through OSMesa) takes 40 ms and draws the distortion not at all. The
/// whole is a function of its arguments: no state is left between pictures.
///
/// Const and thread-safe; copies share the table of rays.
class Endoscope {
 public:
  /// @throws std::invalid_argument if the camera makes no sense, or its distortion folds over
  ///   within the image.
  explicit Endoscope(const vision::CameraModel& camera);

  [[nodiscard]] const vision::CameraModel& camera() const noexcept { return camera_; }
  /// Bytes of a picture.
  [[nodiscard]] std::size_t image_size() const noexcept;

  /// Writes a picture to `bgr`, image_size() bytes, rows from the top. Never allocates.
  void Render(const EndoscopeScene& scene, const EndoscopeLight& light, std::uint64_t noise_seed,
              std::uint8_t* bgr) const noexcept;

  /// `bgr` as what vision takes.
  [[nodiscard]] vision::ImageView View(const std::uint8_t* bgr) const noexcept;

 private:
  struct Tables;
  vision::CameraModel camera_;
  std::shared_ptr<const Tables> tables_;
};

}  // namespace dfr::sim
