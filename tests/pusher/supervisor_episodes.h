#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/imitation/gaussian_policy.h"
#include "dfr/sim/pusher/pusher_plant.h"

namespace dfr::apps::pusher {

struct Counts {
  int completed = 0;
  int collided = 0;
};

/// Runs episodes over start states that neither training nor its stopping rule used.
inline Counts Episodes(const imitation::GaussianPolicy& policy, bool sample, int episodes) {
  constexpr int kHorizon = 60;
  sim::PusherPlant plant;
  std::vector<double> x(plant.state_dim());
  std::vector<double> u(plant.control_dim());
  Counts counts;
  for (std::uint64_t episode = 0; episode < static_cast<std::uint64_t>(episodes); ++episode) {
    plant.Reset(core::DeriveSeed(1911, {episode}));
    core::Random noise(core::DeriveSeed(1912, {episode}));
    for (int t = 0; t < kHorizon && !plant.completed() && !plant.collided(); ++t) {
      plant.Observe(x);
      if (sample) {
        policy.Sample(x, noise, u);
      } else {
        policy.mean().Control(t, x, u);
      }
      EXPECT_EQ(plant.Apply(u), core::PlantStatus::kOk);
    }
    counts.completed += plant.completed();
    counts.collided += plant.collided();
  }
  return counts;
}

}  // namespace dfr::apps::pusher
