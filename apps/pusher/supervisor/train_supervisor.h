#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>

#include "dfr/sim/pusher/pusher_plant.h"

namespace CLI {
class App;
}

namespace dfr::apps::pusher {

struct TrainSupervisorOptions {
  std::filesystem::path out = "supervisor.dfr";  ///< The policy, as imitation::GaussianPolicy.
  /// File of the checkpoint, written every ten iterations and at the end. Empty: `out` with
  /// .checkpoint appended.
  std::filesystem::path checkpoint;
  bool resume = false;  ///< Resume from the checkpoint, which must have the options given.
  /// Seeds all randomness: start states, noise, weights. Empty: 1, or the checkpoint's.
  std::optional<std::uint64_t> seed = {};
  sim::PusherOptions scene;         ///< Scene for the evaluation of the supervisor.
  std::optional<int> horizon = {};  ///< T. Empty: 60, or the checkpoint's.
  double training_red_y = 0.112;    ///< The tighter gate used in training [m], for a margin.
  /// Number of controls before the first evaluation, and maximum number of controls.
  std::int64_t min_steps = 280'000;
  std::int64_t max_steps = 1'200'000;
};

/// Trains a supervisor by TRPO from scratch, showing rates and the remaining time on stderr. After
/// min_steps it is evaluated every ten iterations, over 1000 start states that training does not
/// use. Training ends when the mean action completes at least 99.5 % of these episodes and collides
/// in at most 0.2 %, and sampled actions complete at least 95 %. Finally evaluates the saved policy
/// over 1000 other start states and prints the result. `pusher train-supervisor --seed 1` wrote the
/// supervisor.dfr in this folder: 282212 controls, 19 s.
/// @returns EXIT_SUCCESS, or EXIT_FAILURE if training reached max_steps first; `out` then holds the
/// last policy.
/// @throws std::runtime_error, std::invalid_argument for invalid options or files.
int TrainSupervisor(const TrainSupervisorOptions& options);

/// Adds the option --gripper.
void AddGripper(CLI::App& command, sim::Gripper& gripper);

/// Adds the command train-supervisor, which sets `options` and then calls TrainSupervisor(); an
/// unsuccessful training throws CLI::RuntimeError with its exit code.
void AddTrainSupervisor(CLI::App& app, TrainSupervisorOptions& options);

}  // namespace dfr::apps::pusher
