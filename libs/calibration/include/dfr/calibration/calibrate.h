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

/// Options for Calibrate(). The standard deviations weight each kind of data.
struct CalibrateOptions {
  double mark_sd_px = 0.05;  ///< Standard deviation of a mark's centre.
  /// Standard deviation of the tip's centre. Much larger than the detection error because it
  /// includes errors of the arm that PsmCorrection does not describe.
  double tip_sd_px = 2.0;
  /// Standard deviation of the tip's distance from the target's plane at contact: about tip_sd_px,
  /// converted to metres at the target.
  double touch_sd_m = 4e-4;
  /// Prior standard deviations of PsmCorrection::offset, for a rotating joint and for the
  /// insertion. Without these priors, a rotation of the base about a joint's axis is
  /// indistinguishable from the offset of that joint.
  double offset_sd_rad = 0.05;
  double offset_sd_m = 0.005;
  double scale_sd = 0.03;  ///< Prior standard deviation of PsmCorrection::scale.
  int max_iterations = 200;
  /// Keeps the intrinsics of the guess fixed, for example those from an intrinsics file. If false,
  /// some pictures must show the target tilted.
  bool known_camera = false;
};

/// Result of a calibration.
struct CalibrationSummary {
  bool converged = false;
  int iterations = 0;
  std::string message;  ///< Ceres' termination message.
  int marks = 0;        ///< Number of marks used.
  int tips = 0;
  double mark_rms_px = 0.0;
  double tip_rms_px = 0.0;
  /// Standard deviations from the covariance at the solution. Zero if the covariance could not be
  /// computed (`has_covariance` is false) because the motion does not determine all parameters.
  bool has_covariance = false;
  std::array<double, 9> camera_sd{};  ///< fx, fy, cx, cy, k1, k2, p1, p2, k3
  std::array<double, 6> pose_sd{};    ///< Base in the camera's frame: rotation (rad), position (m).
  std::array<double, 6> offset_sd{};  ///< PsmCorrection::offset: rad; insertion: m.
  std::array<double, 6> scale_sd{};
};

/// Prints the calibrated values with their uncertainties.
void Print(std::ostream& out, const line_task::LineCalibration& calibration,
           const CalibrationSummary& summary);

/// Estimates camera intrinsics, lens distortion, the camera's pose in the arm's base frame and the
/// arm's systematic joint errors from a recorded motion, in one nonlinear least-squares problem.
/// Each picture shows the arm's tip and the target's marks. The target's pose is estimated
/// separately for each picture.
///
/// Minimises the reprojection errors and the tip's distances at contact, each divided by its
/// standard deviation, plus the priors of CalibrateOptions. A Cauchy loss on each point suppresses
/// wrong detections. Ceres eliminates the target poses first (sparse Schur complement).
///
/// A single camera determines depth poorly: scale errors of the arm along the optical axis are
/// nearly indistinguishable from a change of the arm's distance. Pictures in which the tip touches
/// the target's plane, whose pose the marks give, resolve this ambiguity; about forty suffice.
///
/// @param frames  samples of the motion, with varied tilt and height of the target and varied
///   position and height of the tip.
/// @param marks_m  the marks on the target.
/// @param guess  initial values: intrinsics within about 20 %, the camera's pose within about 20 mm
///   and 10 degrees. Calibrate() keeps guess.arm.reference.
/// @param p_cam_target  initial pose of the target for all pictures.
/// @throws std::invalid_argument if fewer than 10 frames show at least 4 marks and the tip, a frame
///   has the wrong number of marks or a non-finite joint, or an option is out of range.
[[nodiscard]] line_task::LineCalibration Calibrate(std::span<const vision::CalibrationFrame> frames,
                                                   std::span<const Eigen::Vector2d> marks_m,
                                                   const line_task::LineCalibration& guess,
                                                   const Eigen::Isometry3d& p_cam_target,
                                                   const CalibrateOptions& options = {},
                                                   CalibrationSummary* summary = nullptr);

}  // namespace dfr::calibration
