#pragma once

#include <span>

#include "dfr/sim/pusher/pusher_plant.h"

namespace dfr::sim {

/// Weights of PusherReward. Distances in metres.
struct PusherRewardOptions {
  double scale = 20.0;      ///< Scale of the potential.
  double reach = 1.0;       ///< Weight of the distance from tip to cylinder.
  double forward = 1.0;     ///< Weight of |c_x - g_x|, cylinder to goal.
  double sideways = 4.0;    ///< Weight of |c_y - g_y|.
  double success = 10.0;    ///< Reward on completion, once.
  double collision = -1.0;  ///< Reward on collision, once.
  double step = 0.0;        ///< Reward for each control.
  double effort = -0.05;    ///< Weight of |u|^2, u clipped to +-1.
};

/// Reward for training the Pusher's supervisors. Learners do not use it.
///
/// Each control earns the change of the potential
///   -scale (reach |tip - object| + forward |c_x - g_x| + sideways |c_y - g_y|),
/// which is largest at completion, plus the other terms of PusherRewardOptions. A collision costs
/// little: with a much larger cost, policies learn not to push at all.
class PusherReward {
 public:
  /// Borrows `plant`, which must outlive it.
  explicit PusherReward(const PusherPlant& plant, const PusherRewardOptions& options = {});

  /// Call after the plant's Reset().
  void Reset() noexcept;
  /// Returns the reward of the last applied control.
  [[nodiscard]] double Step(std::span<const double> control) noexcept;

 private:
  [[nodiscard]] double Potential() const noexcept;

  const PusherPlant* plant_;
  PusherRewardOptions options_;
  double potential_ = 0.0;
};

}  // namespace dfr::sim
