#include "dfr/sim/pusher/pusher_reward.h"

#include <algorithm>
#include <cmath>

namespace dfr::sim {

PusherReward::PusherReward(const PusherPlant& plant, const PusherRewardOptions& options)
    : plant_(&plant), options_(options) {
  Reset();
}

double PusherReward::Potential() const noexcept {
  const auto object = plant_->object_m();
  const auto tip = plant_->tip_m();
  const auto goal = plant_->goal_m();
  const double reach = std::hypot(tip[0] - object[0], tip[1] - object[1], tip[2] - object[2]);
  return -options_.scale *
         (options_.reach * reach + options_.forward * std::abs(object[0] - goal[0]) +
          options_.sideways * std::abs(object[1] - goal[1]));
}

void PusherReward::Reset() noexcept { potential_ = Potential(); }

double PusherReward::Step(std::span<const double> control) noexcept {
  const double before = potential_;
  potential_ = Potential();
  double effort = 0.0;
  for (const double u : control) {
    const double clipped = std::clamp(u, -1.0, 1.0);
    effort += clipped * clipped;
  }
  double reward = potential_ - before + options_.step + options_.effort * effort;
  if (plant_->collided()) reward += options_.collision;
  if (plant_->completed()) reward += options_.success;
  return reward;
}

}  // namespace dfr::sim
