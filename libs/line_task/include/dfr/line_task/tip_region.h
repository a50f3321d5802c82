#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <vector>

#include "dfr/line_task/line_task.h"

namespace dfr::line_task {

/// Permitted region of the jaw tips in the task's world frame: metres, z above the gauze at rest.
struct TipRegionOptions {
  /// A box that the tips must not leave. Its lower z is the floor.
  Eigen::Vector3d box_min_m = Eigen::Vector3d(-0.06, -0.05, 0.0005);
  Eigen::Vector3d box_max_m = Eigen::Vector3d(0.06, 0.05, 0.06);
  /// Boxes that the tips must not enter.
  std::vector<Eigen::AlignedBox3d> forbidden = {};
  /// Planes whose positive side the tips must not leave.
  std::vector<Eigen::Hyperplane<double, 3>> planes = {};

  /// @throws std::invalid_argument if an entry is not finite, a box is empty, or a plane's normal
  ///   is not a unit vector.
  void Check() const;
};

/// Violation of the region at a point, or the deepest violation along a path.
struct Breach {
  double depth_m = 0.0;        ///< Depth of the violation.
  const char* what = nullptr;  ///< Boundary violated: "the floor", ...; nullptr: none.

  [[nodiscard]] bool any() const noexcept { return what != nullptr; }
};

/// Checks whether a path of the arm keeps the tips in the permitted region. Only the constructor
/// allocates or throws. Immutable except for SetGauze() and ForgetGauze(), which only the querying
/// thread may call.
class TipRegion {
 public:
  /// Borrows `task`, which computes tip positions.
  /// @throws as TipRegionOptions::Check().
  TipRegion(const LineTask& task, const TipRegionOptions& options);

  /// Returns the depth and the boundary of the violation at `tip_m` (world frame). A point inside
  /// the region has no violation. A non-finite position has infinite depth.
  [[nodiscard]] Breach At(const Eigen::Vector3d& tip_m) const noexcept;
  /// Checks, in steps of 0.5 mm, the straight path in joint space between two encoder readings, and
  /// returns its deepest violation. A path that starts beyond a bound must not lead farther beyond
  /// it, nor beyond another bound.
  [[nodiscard]] Breach Along(const kinematics::PsmJoints& from,
                             const kinematics::PsmJoints& to) const noexcept;
  /// Sets the last observed pose of the gauze in the world frame. Until ForgetGauze(), the tips
  /// must stay as far above this gauze as the floor is above the gauze at rest.
  void SetGauze(const Eigen::Isometry3d& p_world_gauze) noexcept;
  void ForgetGauze() noexcept { gauze_seen_ = false; }

 private:
  // Calls visit(depth, name) for each bound. depth(tip_m) is the depth of the violation, m.
  template <typename Visit>
  void ForEachBound(const Visit& visit) const;

  const LineTask* task_;
  TipRegionOptions options_;
  Eigen::Hyperplane<double, 3> gauze_;
  bool gauze_seen_ = false;
};

}  // namespace dfr::line_task
