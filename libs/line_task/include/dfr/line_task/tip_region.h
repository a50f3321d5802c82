#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <vector>

#include "dfr/line_task/line_task.h"

namespace dfr::line_task {

/// Where the jaw tips may be, in the task's world frame: metres, z above the gauze at rest.
struct TipRegionOptions {
  /// A box that they may not leave. Its lower z is the floor.
  Eigen::Vector3d box_min_m = Eigen::Vector3d(-0.06, -0.05, 0.0005);
  Eigen::Vector3d box_max_m = Eigen::Vector3d(0.06, 0.05, 0.06);
  /// Boxes that they may not enter.
  std::vector<Eigen::AlignedBox3d> forbidden = {};
  /// Planes whose positive side they may not leave.
  std::vector<Eigen::Hyperplane<double, 3>> planes = {};

  /// @throws std::invalid_argument naming what is not finite, empty, or not of length 1.
  void Check() const;
};

/// Where a way leaves the region.
struct Breach {
  double depth_m = 0.0;        ///< By how much at that place.
  const char* what = nullptr;  ///< What is left or entered: "the floor", ...; nullptr: nothing.

  [[nodiscard]] bool any() const noexcept { return what != nullptr; }
};

/// Looks whether an arm's way keeps the tips where they may be. Neither allocates nor throws but in
/// the constructor. Immutable but for SetGauze(), which belongs to the thread that asks.
class TipRegion {
 public:
  /// Borrows `task`, which knows where the tips are.
  /// @throws as TipRegionOptions::Check().
  TipRegion(const LineTask& task, const TipRegionOptions& options);

  /// How deep `tip_m` (world frame) is where it may not be, and where that is; nothing inside.
  /// A position that is not finite is infinitely deep.
  [[nodiscard]] Breach At(const Eigen::Vector3d& tip_m) const noexcept;
  /// The straight way through joint space between two readings of the encoders, looked at every 0.5
  /// mm: where it is deepest in what is forbidden. A way that begins there may lead out, and never
  /// farther in.
  [[nodiscard]] Breach Along(const kinematics::PsmJoints& from,
                             const kinematics::PsmJoints& to) const noexcept;
  /// The gauze as it was last seen, pose in the world frame: the tips may not come nearer to its
  /// plane than to the floor at rest. Until ForgetGauze().
  void SetGauze(const Eigen::Isometry3d& p_world_gauze) noexcept;
  void ForgetGauze() noexcept { gauze_seen_ = false; }

 private:
  const LineTask* task_;
  TipRegionOptions options_;
  Eigen::Hyperplane<double, 3> gauze_;
  bool gauze_seen_ = false;
};

}  // namespace dfr::line_task
