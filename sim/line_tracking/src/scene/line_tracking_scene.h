#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "dfr/kinematics/psm.h"
#include "dfr/sim/mujoco/mujoco_model.h"
#include "scene/gauze_line.h"

namespace dfr::sim::internal {

/// Positions that other parts of the program determine.
struct ScenePlaces {
  Eigen::Isometry3d p_world_base = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d p_world_cam = Eigen::Isometry3d::Identity();  ///< Pose in OpenCV's axes.
  double camera_fovy_rad = 0.7;
  std::vector<Eigen::Vector2d> marks_m;  ///< Eight marks, in the gauze's frame.
};

/// The MuJoCo model with all bodies in place, and the indices of its parts. Immutable: copy it to
/// draw on the gauze.
class SceneModel {
 public:
  /// @throws std::runtime_error if the model cannot be compiled.
  explicit SceneModel(const ScenePlaces& places);

  [[nodiscard]] const mjModel_& mj() const noexcept { return *model_; }
  [[nodiscard]] MjModelPtr CopyMj() const;

  std::array<int, 6> joint_qpos{};
  int tip_site = 0;
  int gauze_body = 0;
  int gauze_mocap = 0;
  std::array<int, 6> arm_mocap{};
  std::array<int, 6> leg_mocap{};
  int gauze_texture = 0;

 private:
  MjModelPtr model_;
};

/// Computes the poses of all bodies from the joints and the gauze's pose. Allocates only at
/// construction.
class SceneData {
 public:
  explicit SceneData(const SceneModel& model);

  /// Sets the true joints and the gauze's pose.
  void Place(const kinematics::PsmJoints& joints, const Eigen::Isometry3d& p_world_gauze) noexcept;

  /// Sets the platform's servo arms and legs to match the gauze's pose; for pictures only.
  void PlaceLegs() noexcept;

  [[nodiscard]] Eigen::Vector3d tip_m() const noexcept;  ///< World frame.
  [[nodiscard]] Eigen::Isometry3d p_world_gauze() const noexcept;
  [[nodiscard]] const mjData_& mj() const noexcept { return *data_; }

 private:
  void PlaceRod(int mocap, const Eigen::Vector3d& from, const Eigen::Vector3d& to) noexcept;

  const SceneModel* model_;
  MjDataPtr data_;
};

inline constexpr double kLineWidth = 0.0015;      ///< m
inline constexpr double kLineHalfLength = 0.032;  ///< m; the line is drawn for |x| below this

/// Draws the gauze and the line on the texture of `model`, a copy of the scene's model.
void DrawGauze(const SceneModel& scene, const GauzeLine& line, bool with_line, mjModel_& model);

}  // namespace dfr::sim::internal
