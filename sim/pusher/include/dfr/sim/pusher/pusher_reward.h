#pragma once

#include <span>

#include "dfr/sim/pusher/pusher_plant.h"

namespace dfr::sim {

/// Weights of PusherReward. Distances in metres.
struct PusherRewardOptions {
  double scale = 20.0;      ///< Scales the potential.
  double reach = 1.0;       ///< Times the distance from tip to cylinder.
  double forward = 1.0;     ///< Times |c_x - g_x|, cylinder to goal.
  double sideways = 4.0;    ///< Times |c_y - g_y|.
  double success = 10.0;    ///< Once, when completed.
  double collision = -1.0;  ///< Once, when collided.
  double step = 0.0;        ///< Each control.
  double effort = -0.05;    ///< Times |u|^2, u clipped to +-1.
};

/// The reward that supervisors of the Pusher are trained with. Learners never see it.
///
/// Each control earns the change of the potential
///   -scale (reach |tip - object| + forward |c_x - g_x| + sideways |c_y - g_y|),
/// which is largest where the task is done, plus the terms above. A collision costs little: much
/// more, and policies learn not to push at all.
class PusherReward {
 public:
  /// Borrows `plant`, which must outlive it.
  explicit PusherReward(const PusherPlant& plant, const PusherRewardOptions& options = {});

  /// Call after the plant's Reset().
  void Reset() noexcept;
  /// The reward of the control that the plant has just applied.
  [[nodiscard]] double Step(std::span<const double> control) noexcept;

 private:
  [[nodiscard]] double Potential() const noexcept;

  const PusherPlant* plant_;
  PusherRewardOptions options_;
  double potential_ = 0.0;
};

}  // namespace dfr::sim
