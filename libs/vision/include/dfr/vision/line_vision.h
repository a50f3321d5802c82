#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <limits>
#include <memory>
#include <vector>

#include "dfr/vision/camera_model.h"
#include "dfr/vision/image_view.h"

namespace dfr::vision {

/// Why an image says nothing.
enum class NotSeen {
  kNothing,        ///< Nothing is missing: all was seen.
  kWrongSize,      ///< The image has not the camera's size.
  kDark,           ///< Nearly black.
  kOverexposed,    ///< Mostly saturated.
  kFrozen,         ///< The same image as before, bit for bit: a living sensor has noise.
  kTarget,         ///< Fewer than four marks of the gauze's frame, or all on one line.
  kForeignCamera,  ///< The marks do not fit together: another camera's intrinsics, or a bent frame.
  kLine,           ///< No red line, too short a piece of it, or not near the tip.
  kTip,            ///< No end-effector.
  kFault,          ///< OpenCV failed (out of memory).
};
inline constexpr int kNumNotSeen = static_cast<int>(NotSeen::kFault) + 1;

[[nodiscard]] const char* Name(NotSeen reason) noexcept;

/// What LineVision looks for. Metres; the target's frame lies in the gauze, z towards the camera's
/// side.
struct LineTarget {
  std::vector<Eigen::Vector2d> marks_m;  ///< Centres of the blue marks on the gauze's frame.
  double mark_radius_m = 0.002;
  double line_width_m = 0.0015;
  double tip_radius_m = 0.001;  ///< Radius of the green ball on the end-effector.
};

/// Options for LineVision.
struct LineVisionOptions {
  LineTarget target;
  /// The target's pose when nothing disturbs it, in the camera's frame: a mark is the one whose
  /// place then is the nearest.
  Eigen::Isometry3d p_cam_target = Eigen::Isometry3d::Identity();
  /// How far the target can be from there. A pose beyond is that of another camera's intrinsics,
  /// which trade focal length for distance.
  double max_motion_m = 0.03;
  double min_confidence = 0.3;  ///< Below this, nothing is reported.
};

/// What one image shows. Numbers are NaN unless seen().
struct LineObservation {
  NotSeen missing = NotSeen::kTarget;
  /// In [0, 1]: the smallest of the shares of marks, line points and tip area that fit.
  double confidence = 0.0;
  /// From the tip, projected along the gauze's normal, to the line; in the gauze's plane, positive
  /// if the tip is to the left of the line's direction (its +y side), m.
  double distance_m = std::numeric_limits<double>::quiet_NaN();
  Eigen::Vector3d p_cam_tip = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  /// Unit tangent of the line where it is nearest to the tip, in the camera's frame.
  Eigen::Vector3d tangent_cam = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  /// Pose of the gauze in the camera's frame; valid as soon as the marks were seen.
  Eigen::Isometry3d p_cam_target = Eigen::Isometry3d::Identity();
  /// The line in the gauze's frame, y = c0 + c1 x + c2 x^2, for x in [x_min, x_max], m.
  Eigen::Vector3d line = Eigen::Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  double x_min = std::numeric_limits<double>::quiet_NaN();
  double x_max = std::numeric_limits<double>::quiet_NaN();
  Eigen::Vector2d tip_pixel = Eigen::Vector2d::Constant(std::numeric_limits<double>::quiet_NaN());
  double mark_error_px = std::numeric_limits<double>::quiet_NaN();  ///< RMS over the marks.
  double line_error_m = std::numeric_limits<double>::quiet_NaN();   ///< RMS over line points.

  [[nodiscard]] bool seen() const noexcept { return missing == NotSeen::kNothing; }
};

/// Finds a red line on gauze and the tip of the tool in an endoscope's image.
///
/// The gauze's plane comes from blue marks on the frame that holds it, so that millimetres in the
/// gauze stay millimetres when the platform below moves. The line is the robust quadratic through
/// the centres of the red run of every image column; it has to run along the image's width, within
/// 45 degrees. The tip is the green ball at the tool's end; one camera does not see how far away it
/// is, so the caller gives a plane that it is on, from the arm's kinematics.
///
/// Observe() neither throws nor guesses: what is not there is reported as NotSeen. OpenCV may
/// allocate inside. One object belongs to one thread.
class LineVision {
 public:
  /// @throws std::invalid_argument if the camera or the target makes no sense; names which.
  LineVision(const CameraModel& camera, const LineVisionOptions& options);
  ~LineVision();
  LineVision(LineVision&&) noexcept;
  LineVision& operator=(LineVision&&) noexcept;

  /// @param tip_plane_cam  the plane that the tip is on, in the camera's frame.
  [[nodiscard]] LineObservation Observe(const ImageView& image,
                                        const Eigen::Hyperplane<double, 3>& tip_plane_cam) noexcept;

  /// The tip alone, in pixels: what a calibration records. NaN if it is not seen.
  [[nodiscard]] Eigen::Vector2d FindTip(const ImageView& image) noexcept;

  /// The marks alone, in pixels, in the target's order; NaN for those not seen. Needs no valid
  /// intrinsics, but the nominal pose has to be right to a third of the distance of two marks.
  /// @param marks  as many entries as the target has marks.
  [[nodiscard]] bool FindMarks(const ImageView& image,
                               std::vector<Eigen::Vector2d>& marks) noexcept;

  /// Forgets the last image, so that the next one is not compared with it.
  void ForgetLastImage() noexcept;

  [[nodiscard]] const CameraModel& camera() const noexcept;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace dfr::vision
