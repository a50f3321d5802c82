#pragma once

#include <cstdint>
#include <filesystem>

#include "dfr/sim/pusher/pusher_plant.h"

namespace CLI {
class App;
}

namespace dfr::apps::pusher {

struct TrainSupervisorOptions {
  std::filesystem::path out = "supervisor.dfr";  ///< The policy, as imitation::GaussianPolicy.
  /// Written every ten iterations and at the end, for resume. Empty: `out` with .checkpoint behind.
  std::filesystem::path checkpoint;
  bool resume = false;            ///< Go on from the checkpoint; its own seed is used.
  std::uint64_t seed = 1;         ///< Of everything: start states, noise, weights.
  sim::PusherOptions scene;       ///< What the supervisor is judged in.
  double training_red_y = 0.112;  ///< The tighter gate that it is trained at [m]: its margin.
  /// Controls before the supervisor is judged for the first time, and at most.
  std::int64_t min_steps = 280'000;
  std::int64_t max_steps = 1'200'000;
};

/// Trains a supervisor by TRPO from scratch, showing rates and the time left on stderr. From
/// min_steps on it is judged every ten iterations, over 1000 start states that training does not
/// use; training ends when its mean action completes at least 99.5 % and collides in at most 0.2 %
/// of them, and its samples complete at least 95 %. What is saved is judged again over 1000 other
/// start states, and that is printed. The supervisor.dfr beside this file is what
/// `pusher train-supervisor --seed 1` wrote: 282212 controls, 19 s.
/// @return EXIT_SUCCESS, or EXIT_FAILURE if max_steps came first: `out` then holds the last policy.
/// @throws std::runtime_error, std::invalid_argument for options or files that do not work.
int TrainSupervisor(const TrainSupervisorOptions& options);

/// Adds the command train-supervisor, which sets `options` and then calls TrainSupervisor(); an
/// unsuccessful training ends in CLI::RuntimeError with its exit code.
void AddTrainSupervisor(CLI::App& app, TrainSupervisorOptions& options);

}  // namespace dfr::apps::pusher
