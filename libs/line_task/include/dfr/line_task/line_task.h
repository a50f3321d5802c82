#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <filesystem>
#include <span>

#include "dfr/core/features/features.h"
#include "dfr/core/files/provenance.h"
#include "dfr/kinematics/psm.h"
#include "dfr/vision/camera_model.h"
#include "dfr/vision/line_vision.h"

namespace dfr::line_task {

/// Calibration of the camera and the arm, used by vision and control.
struct LineCalibration {
  vision::CameraModel camera;
  Eigen::Isometry3d p_base_cam =
      Eigen::Isometry3d::Identity();  ///< Camera in the arm's base frame.
  kinematics::PsmCorrection arm;
  core::Provenance provenance = {};

  /// Returns the position of the jaw tips in the camera's frame, m, when the arm reports `joints`.
  [[nodiscard]] Eigen::Vector3d TipInCamera(const kinematics::PsmJoints& joints) const noexcept;

  /// Writes a file of kind "calibration". @throws std::runtime_error naming the file.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and the error.
  static LineCalibration Load(const std::filesystem::path& path);
};

/// Returns the marks and sizes of the gauze and its frame, as printed.
[[nodiscard]] vision::LineTarget StandardTarget();

/// The line tracking task of the paper's Sec. V-B, independent of the arm and the camera: the
/// mapping from images to states and from controls to arm motions. The simulation and the robot
/// share this mapping, which makes learned models transferable between them.
///
/// World frame: the gauze's frame at rest; origin at its centre, z up, the line roughly along x.
///
/// State (4), in millimetres to give all entries the same order of magnitude:
///
///   tip(2)       position of the tool's tip in the world frame, x and y
///   distance(1)  from the line to the tip in the gauze's plane, positive to the left (+y)
///   heading(1)   direction of the line next to the tip: 10 mm times its angle to the x-axis in rad
/// All entries are NaN if the image does not show both line and tip. Every controller then halts.
///
/// Control (2): displacement of the tool in x and y, in units of kStep. The tool keeps the height
/// and orientation of the arm's home pose. Entries beyond +-1 saturate.
///
/// Immutable and thread-safe. Only the constructor allocates or throws.
class LineTask {
 public:
  static constexpr double kStep = 0.002;       ///< m per unit of control.
  static constexpr double kSpeed = 0.010;      ///< Speed of the tool, m/s.
  static constexpr double kCollision = 0.004;  ///< Collision beyond this distance from the line, m.
  static constexpr double kCompletion = 0.040;  ///< Length of line to track, m.

  /// @param p_world_base  pose of the arm's base in the world frame.
  /// @param generation  determines the joint limits.
  LineTask(const LineCalibration& calibration, const Eigen::Isometry3d& p_world_base,
           kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic);

  [[nodiscard]] const core::StateLayout& layout() const noexcept { return layout_; }
  [[nodiscard]] const LineCalibration& calibration() const noexcept { return calibration_; }
  [[nodiscard]] const Eigen::Isometry3d& p_world_base() const noexcept { return p_world_base_; }
  /// Options for vision::LineVision, which expects the gauze at its rest pose.
  [[nodiscard]] const vision::LineVisionOptions& vision() const noexcept { return vision_; }

  /// Computes the encoder readings to command for a tip position in the world frame. Returns false,
  /// with `reading` unspecified, if the arm cannot reach it.
  [[nodiscard]] bool Reading(const Eigen::Vector3d& tip_m,
                             kinematics::PsmJoints& reading) const noexcept;
  /// Returns the position of the tip in the world frame for encoder readings `reading`, m.
  [[nodiscard]] Eigen::Vector3d Tip(const kinematics::PsmJoints& reading) const noexcept;
  /// Returns the displacement of the tip commanded by `control`, world frame, m. @pre 2 finite
  /// entries
  [[nodiscard]] static Eigen::Vector3d Displacement(std::span<const double> control) noexcept;
  /// Returns the plane through the tip, parallel to the gauze at rest, in the camera's frame. The
  /// arm's kinematics give the height of the tip, which one camera cannot measure.
  [[nodiscard]] Eigen::Hyperplane<double, 3> TipPlane(
      const kinematics::PsmJoints& reading) const noexcept;
  /// Writes the state observed in `seen` (4 entries).
  void State(const vision::LineObservation& seen, std::span<double> state) const noexcept;
  /// Returns the length of the line between the tip's positions in two observations of an episode,
  /// m. Uses the line of the second observation. NaN unless both are seen().
  [[nodiscard]] static double Progress(const vision::LineObservation& first,
                                       const vision::LineObservation& now) noexcept;
  /// Writes the state for the tip `tip_m` in the world frame and a line at the given distance from
  /// the tip and angle to the x-axis.
  static void State(const Eigen::Vector3d& tip_m, double distance_m, double heading_rad,
                    std::span<double> state) noexcept;

 private:
  LineCalibration calibration_;
  Eigen::Isometry3d p_world_base_;
  Eigen::Isometry3d p_base_world_;
  Eigen::Isometry3d p_world_cam_;
  Eigen::Isometry3d p_cam_world_;
  Eigen::Matrix3d tool_rotation_;
  kinematics::PsmGeneration generation_;
  core::StateLayout layout_;
  vision::LineVisionOptions vision_;
};

}  // namespace dfr::line_task
