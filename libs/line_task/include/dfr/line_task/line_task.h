#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <filesystem>
#include <span>

#include "dfr/core/features.h"
#include "dfr/core/provenance.h"
#include "dfr/kinematics/psm.h"
#include "dfr/vision/camera_model.h"
#include "dfr/vision/line_vision.h"

namespace dfr::line_task {

/// What is known of camera and arm: what a calibration finds, and what vision works with.
struct LineCalibration {
  vision::CameraModel camera;
  Eigen::Isometry3d p_base_cam =
      Eigen::Isometry3d::Identity();  ///< Camera in the arm's base frame.
  kinematics::PsmCorrection arm;
  core::Provenance provenance = {};

  /// Where the camera sees the jaw tips when the arm reports `joints`, camera frame, m.
  [[nodiscard]] Eigen::Vector3d TipInCamera(const kinematics::PsmJoints& joints) const noexcept;

  /// A file of kind "calibration". @throws std::runtime_error naming the file.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and what is wrong with it.
  static LineCalibration Load(const std::filesystem::path& path);
};

/// Marks and sizes of the gauze and its frame, as printed.
[[nodiscard]] vision::LineTarget StandardTarget();

/// The line tracking task of Sec. V-B without saying whose arm and whose camera: which state an
/// image shows, and where a control sends the arm. A simulation and a robot share it, so that what
/// was learned on one means the same on the other.
///
/// World frame: the gauze's when nothing moves it; origin in its middle, z up, the line roughly
/// along x.
///
/// State (4), in millimetres so that its entries are of one magnitude:
///   tip(2)       the tool's tip, x and y in the world frame
///   distance(1)  of the tip to the line in the gauze's plane, positive to the left (+y)
///   heading(1)   direction of the line next to the tip: 10 mm times its angle to the x-axis, rad
/// All entries are NaN when the image does not show line and tip, which every controller turns into
/// a halt.
///
/// Control (2): displacement of the tool in x and y, in units of kStep; it keeps its height and its
/// orientation, that of the arm's home. Entries beyond +-1 saturate.
///
/// Immutable: safe to share between threads. Nothing but the constructor allocates or throws.
class LineTask {
 public:
  static constexpr double kStep = 0.002;        ///< m per unit of control.
  static constexpr double kSpeed = 0.010;       ///< m/s of the tool.
  static constexpr double kCollision = 0.004;   ///< m: further from the line is a collision.
  static constexpr double kCompletion = 0.040;  ///< m of line to track.

  /// @param p_world_base  the arm's base in the world frame.
  /// @param generation  whose joint limits count.
  LineTask(const LineCalibration& calibration, const Eigen::Isometry3d& p_world_base,
           kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic);

  [[nodiscard]] const core::StateLayout& layout() const noexcept { return layout_; }
  [[nodiscard]] const LineCalibration& calibration() const noexcept { return calibration_; }
  [[nodiscard]] const Eigen::Isometry3d& p_world_base() const noexcept { return p_world_base_; }
  /// For vision::LineVision, which looks for the gauze where it is when nothing moves it.
  [[nodiscard]] const vision::LineVisionOptions& vision() const noexcept { return vision_; }

  /// The encoder readings to command for a tip position in the world frame. False, with `reading`
  /// perhaps changed, if the arm cannot reach it.
  [[nodiscard]] bool Reading(const Eigen::Vector3d& tip_m,
                             kinematics::PsmJoints& reading) const noexcept;
  /// The tip in the world frame where the encoders say `reading`, m.
  [[nodiscard]] Eigen::Vector3d Tip(const kinematics::PsmJoints& reading) const noexcept;
  /// What `control` asks of the tip, world frame, m. @pre 2 finite entries
  [[nodiscard]] static Eigen::Vector3d Displacement(std::span<const double> control) noexcept;
  /// The plane that the tip is on, camera frame: the arm knows how high its tip is, one camera does
  /// not.
  [[nodiscard]] Eigen::Hyperplane<double, 3> TipPlane(
      const kinematics::PsmJoints& reading) const noexcept;
  /// Writes the state that `seen` shows (4 entries).
  void State(const vision::LineObservation& seen, std::span<double> state) const noexcept;
  /// The length of line between the tips of two observations of an episode, along the line as the
  /// second shows it, m; NaN unless both were seen.
  [[nodiscard]] static double Progress(const vision::LineObservation& first,
                                       const vision::LineObservation& now) noexcept;
  /// The state of a tip in the world frame and a line with this distance and angle to the x-axis.
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
