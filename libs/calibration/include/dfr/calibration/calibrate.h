#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <iosfwd>
#include <span>
#include <string>
#include <vector>

#include "dfr/line_task/line_task.h"
#include "dfr/vision/calibration_frame.h"

namespace dfr::calibration {

/// Options for Calibrate(). Standard deviations say how much to believe each kind of data.
struct CalibrateOptions {
  double mark_sd_px = 0.05;  ///< A mark's sub-pixel centre.
  /// The tip's sub-pixel centre: far more than the image's error, because no correction describes
  /// all of the arm's.
  double tip_sd_px = 2.0;
  /// The tip's distance to the target's plane where it touches it; large for the same reason.
  double touch_sd_m = 4e-4;
  /// Prior knowledge of the arm, without which a turn of the base about a joint's axis and that
  /// joint's offset could not be told apart: the offset of a rotating joint and of the insertion.
  double offset_sd_rad = 0.05;
  double offset_sd_m = 0.005;
  double scale_sd = 0.03;  ///< A joint's scale.
  int max_iterations = 200;
  /// The guess's intrinsics are right, as those of a file of their own are: they stay. Without it
  /// the target has to be seen tilted.
  bool known_camera = false;
};

/// How a calibration went.
struct CalibrationSummary {
  bool converged = false;
  int iterations = 0;
  std::string message;  ///< Ceres' reason to stop.
  int marks = 0;        ///< Sightings used.
  int tips = 0;
  double mark_rms_px = 0.0;
  double tip_rms_px = 0.0;
  /// Standard deviations, from the covariance at the solution. Zero if that could not be computed
  /// (`has_covariance` false): the motion did not show all there is to find.
  bool has_covariance = false;
  std::array<double, 9> camera_sd{};  ///< fx, fy, cx, cy, k1, k2, p1, p2, k3
  std::array<double, 6> pose_sd{};    ///< Rotation (rad), then translation (m), of p_base_cam.
  std::array<double, 6> offset_sd{};  ///< PsmCorrection::offset: rad, the insertion in m.
  std::array<double, 6> scale_sd{};
};

/// Prints a table of values with their uncertainty.
void Print(std::ostream& out, const line_task::LineCalibration& calibration,
           const CalibrationSummary& summary);

/// Camera intrinsics, lens distortion, the camera's place in the arm's base frame and the arm's
/// systematic joint errors, all in one nonlinear least-squares problem over a recorded motion: each
/// picture shows the target's marks, in an unknown pose of its own, and the arm's tip.
///
/// Minimises the reprojection errors over their standard deviations, Cauchy's loss on each point so
/// that a wrong detection does not count, plus the priors of CalibrateOptions; Ceres eliminates the
/// poses of the pictures first (sparse Schur complement).
///
/// One camera sees depth badly: along its axis, the arm's scale errors and its distance look alike.
/// Pictures in which the tip touches the target's plane, whose pose the marks give, settle that;
/// some forty of them are enough.
///
/// @param frames  of the motion; they should differ in tilt and height of the target, and in place
///   and height of the tip.
/// @param marks_m  the marks on the target.
/// @param guess  to start from: intrinsics within some 20 %, the camera's place within some 20 mm
///   and 10 degrees. Its arm.reference is kept.
/// @param p_cam_target  guess for the target's pose in all pictures.
/// @throws std::invalid_argument if there are fewer than 10 frames with at least 4 marks and a tip,
///   a frame's number of marks is wrong, or an option is out of range.
[[nodiscard]] line_task::LineCalibration Calibrate(std::span<const vision::CalibrationFrame> frames,
                                                   std::span<const Eigen::Vector2d> marks_m,
                                                   const line_task::LineCalibration& guess,
                                                   const Eigen::Isometry3d& p_cam_target,
                                                   const CalibrateOptions& options = {},
                                                   CalibrationSummary* summary = nullptr);

}  // namespace dfr::calibration
