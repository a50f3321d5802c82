#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <limits>
#include <memory>
#include <vector>

#include "dfr/vision/camera_model.h"
#include "dfr/vision/image_view.h"

namespace dfr::vision {

/// Reasons for an image without a result.
enum class NotSeen {
  kNothing,        ///< No reason: everything was seen.
  kWrongSize,      ///< The image size differs from the camera's.
  kDark,           ///< Nearly black.
  kOverexposed,    ///< More than 30 % of the pixels are saturated.
  kFrozen,         ///< Sampled pixels equal those of the previous image, without any sensor noise.
  kTarget,         ///< Fewer than four marks of the gauze's frame seen, or all on one line.
  kForeignCamera,  ///< Inconsistent marks: intrinsics of another camera, or a bent frame.
  kLine,           ///< No red line, or its visible piece is too short or not near the tip.
  kTip,            ///< The green ball at the tool's tip was not found, or is ambiguous.
  kFault,          ///< OpenCV failed (out of memory).
};

[[nodiscard]] const char* Name(NotSeen reason) noexcept;

/// Objects that LineVision detects. Metres; the target's frame lies in the gauze, z towards the
/// camera.
struct LineTarget {
  std::vector<Eigen::Vector2d> marks_m;  ///< Centres of the blue marks on the gauze's frame.
  double mark_radius_m = 0.002;
  double line_width_m = 0.0015;
  double tip_radius_m = 0.001;  ///< Radius of the green ball at the end-effector.
};

/// Options for LineVision.
struct LineVisionOptions {
  LineTarget target;
  /// Pose of the target at rest, in the camera's frame. A detected mark is assigned to the nearest
  /// mark in this pose.
  Eigen::Isometry3d p_cam_target = Eigen::Isometry3d::Identity();
  /// Maximum displacement of the target from p_cam_target. A larger displacement indicates the
  /// intrinsics of another camera: a wrong focal length appears as a wrong distance.
  double max_motion_m = 0.03;
  double min_confidence = 0.3;  ///< Minimum confidence of a result.
};

/// Result for one image. distance_m, p_cam_tip and tangent_cam are NaN unless seen(); other numbers
/// are NaN if they were not determined.
struct LineObservation {
  NotSeen missing = NotSeen::kTarget;
  /// In [0, 1]: the smallest of the fraction of marks that fit, the fraction of line points that
  /// fit, and the ratio of the tip's area to its expected area (or the reciprocal if above 1).
  double confidence = 0.0;
  /// Distance from the tip, projected along the gauze's normal, to the line, in the gauze's plane,
  /// m. Positive if the tip is to the left of the line's direction (its +y side).
  double distance_m = std::numeric_limits<double>::quiet_NaN();
  Eigen::Vector3d p_cam_tip = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  /// Unit tangent of the line at the point nearest to the tip, in the camera's frame.
  Eigen::Vector3d tangent_cam = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  /// Pose of the gauze in the camera's frame. Valid if the marks were seen.
  Eigen::Isometry3d p_cam_target = Eigen::Isometry3d::Identity();
  /// Line in the gauze's frame, y = c0 + c1 x + c2 x^2, for x in [x_min, x_max], m.
  Eigen::Vector3d line = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  double x_min = std::numeric_limits<double>::quiet_NaN();
  double x_max = std::numeric_limits<double>::quiet_NaN();
  Eigen::Vector2d tip_pixel = Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  double mark_error_px = std::numeric_limits<double>::quiet_NaN();  ///< RMS over the marks.
  double line_error_m = std::numeric_limits<double>::quiet_NaN();   ///< RMS over line points.

  [[nodiscard]] bool seen() const noexcept { return missing == NotSeen::kNothing; }
};

/// Detects a red line on gauze and the tip of the tool in an endoscope's image.
///
/// Blue marks on the gauze's frame give the gauze's plane, which keeps distances metric when the
/// platform moves. The line is a robust quadratic fit through the centres of the red run in every
/// image column. It must run along the image's width, within 45 degrees. The tip is the green ball
/// at the tool's end. One camera cannot measure the tip's distance; the caller provides a plane
/// that contains the tip, from the arm's kinematics.
///
/// Observe() never throws, and reports missing objects as NotSeen. OpenCV may allocate internally.
/// One object belongs to one thread.
class LineVision {
 public:
  /// @throws std::invalid_argument naming the invalid part of the camera or the options.
  LineVision(const CameraModel& camera, const LineVisionOptions& options);
  ~LineVision();
  LineVision(LineVision&&) noexcept;
  LineVision& operator=(LineVision&&) noexcept;

  /// @param tip_plane_cam  the plane that contains the tip, in the camera's frame.
  [[nodiscard]] LineObservation Observe(const ImageView& image,
                                        const Eigen::Hyperplane<double, 3>& tip_plane_cam) noexcept;

  /// Detects only the tip, for a calibration. Returns pixels; NaN if not seen.
  [[nodiscard]] Eigen::Vector2d FindTip(const ImageView& image) noexcept;

  /// Detects only the marks. Works without valid intrinsics, but p_cam_target must be accurate to a
  /// third of the distance between two marks. Returns true if at least four marks are seen.
  /// @param marks  receives pixels in the target's order, NaN for marks not seen; unchanged if the
  ///   image is dark, overexposed or of the wrong size.
  [[nodiscard]] bool FindMarks(const ImageView& image,
                               std::vector<Eigen::Vector2d>& marks) noexcept;

  /// Discards the last image: the next one is not compared with it.
  void ForgetLastImage() noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::vision
