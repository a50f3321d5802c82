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

/// Returns the file of the shipped supervisor `number` >= 1, in ../share/dfr/pusher of the
/// program's folder.
[[nodiscard]] std::filesystem::path ShippedSupervisor(int number = 1);

/// Number of shipped supervisors, trained by train-supervisor with the seeds 1, 2, ...
inline constexpr int kShippedSupervisors = 5;

/// Returns the first `count` shipped supervisors; ShippedSupervisor() is the first.
/// @throws std::invalid_argument if there are fewer; std::runtime_error naming an unreadable file.
[[nodiscard]] std::vector<imitation::GaussianPolicy> LoadShippedSupervisors(int count);

/// Returns the supervisor of a file of train-supervisor.
/// @throws std::runtime_error naming a missing or unreadable file.
[[nodiscard]] imitation::GaussianPolicy LoadSupervisor(const std::filesystem::path& file);

/// Numbers of kept and discarded episodes of Demonstrate().
struct DemonstrationCounts {
  int kept = 0;
  int collided = 0;    ///< Discarded: a demonstration must not violate a constraint (Sec. III).
  int incomplete = 0;  ///< Discarded: over the time limit.
};

/// Runs the supervisor, which samples its Gaussian policy, until `count` demonstrations have
/// completed the task without a violation. Start states and noise are streams of `seed`. With the
/// mean action, all demonstrations would have the same timing, and a learner that lags would leave
/// the time-indexed support at once.
/// @throws std::runtime_error if fewer than one episode in ten is usable.
imitation::DemonstrationSet Demonstrate(sim::PusherPlant& plant,
                                        const imitation::GaussianPolicy& supervisor, int count,
                                        int horizon, std::uint64_t seed,
                                        DemonstrationCounts* counts = nullptr,
                                        const std::function<void(int done)>& progress = {});

}  // namespace dfr::apps::pusher
