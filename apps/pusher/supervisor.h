#pragma once

#include <atomic>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <vector>

#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/gaussian_policy.h"
#include "dfr/sim/pusher/pusher_plant.h"

namespace dfr::apps::pusher {

/// The supervisor that is shipped: ../share/dfr/pusher/supervisor.dfr beside the running program.
[[nodiscard]] std::filesystem::path ShippedSupervisor();

/// How many supervisors are shipped: train-supervisor's of the seeds 1, 2, ...
inline constexpr int kShippedSupervisors = 5;

/// The first `count` of them; ShippedSupervisor() is the first.
/// @throws std::invalid_argument if there are not as many; std::runtime_error naming the file.
[[nodiscard]] std::vector<imitation::GaussianPolicy> LoadShippedSupervisors(int count);

/// What Demonstrate() saw besides the demonstrations that it returns.
struct DemonstrationCounts {
  int kept = 0;
  int collided = 0;    ///< Discarded: a demonstration does not violate the constraints (Sec. III).
  int incomplete = 0;  ///< Discarded: out of time.
};

/// Runs the supervisor, which samples its own Gaussian, until `count` demonstrations without a
/// violation that complete the task are there. Start states and noise are streams of `seed`. Why it
/// samples: with its mean action every demonstration has the same timing, and a learner that lags
/// behind leaves the time-indexed support at once.
/// @throws std::runtime_error if fewer than one episode in ten is usable.
imitation::DemonstrationSet Demonstrate(sim::PusherPlant& plant,
                                        const imitation::GaussianPolicy& supervisor, int count,
                                        int horizon, std::uint64_t seed,
                                        DemonstrationCounts* counts = nullptr,
                                        const std::function<void(int done)>& progress = {});

}  // namespace dfr::apps::pusher
