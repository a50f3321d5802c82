#include "supervisor/supervisor.h"

#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"

namespace dfr::apps::pusher {
namespace {

// One sampled episode, with the controls that the plant received.
core::Trajectory Episode(sim::PusherPlant& plant, const imitation::GaussianPolicy& supervisor,
                         int horizon, std::uint64_t seed) {
  const int state_dim = plant.state_dim();
  const int control_dim = plant.control_dim();
  core::Matrix states(horizon + 1, state_dim);
  core::Matrix controls(horizon, control_dim);
  core::Random random(core::DeriveSeed(seed, {1}));
  core::Trajectory trajectory;
  trajectory.seed = core::DeriveSeed(seed, {0});
  plant.Reset(trajectory.seed);
  plant.Observe(core::Row(states, 0));
  int steps = 0;
  while (steps < horizon && !plant.completed() && !plant.collided()) {
    supervisor.Sample(core::Row(std::as_const(states), steps), random, core::Row(controls, steps));
    if (plant.Apply(core::Row(std::as_const(controls), steps)) != core::PlantStatus::kOk) {
      throw std::runtime_error("the simulation failed while the supervisor demonstrated");
    }
    ++steps;
    plant.Observe(core::Row(states, steps));
  }
  trajectory.outcome = plant.collided()    ? core::Outcome::kCollided
                       : plant.completed() ? core::Outcome::kCompleted
                                           : core::Outcome::kHalted;
  trajectory.states = states.topRows(steps + 1);
  trajectory.controls = controls.topRows(steps);
  return trajectory;
}

}  // namespace

std::filesystem::path ShippedSupervisor() {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  return program.parent_path().parent_path() / "share" / "dfr" / "pusher" / "supervisor.dfr";
}

std::vector<imitation::GaussianPolicy> LoadShippedSupervisors(int count) {
  DFR_THROW_UNLESS(count >= 1 && count <= kShippedSupervisors,
                   "there are 1 to " << kShippedSupervisors << " supervisors, not " << count);
  const std::filesystem::path first = ShippedSupervisor();
  std::vector<imitation::GaussianPolicy> supervisors = {imitation::GaussianPolicy::Load(first)};
  supervisors.reserve(static_cast<std::size_t>(count));
  for (int i = 2; i <= count; ++i) {
    supervisors.push_back(imitation::GaussianPolicy::Load(
        first.parent_path() / ("supervisor_" + std::to_string(i) + ".dfr")));
  }
  return supervisors;
}

imitation::DemonstrationSet Demonstrate(sim::PusherPlant& plant,
                                        const imitation::GaussianPolicy& supervisor, int count,
                                        int horizon, std::uint64_t seed,
                                        DemonstrationCounts* counts,
                                        const std::function<void(int done)>& progress) {
  imitation::DemonstrationSet set;
  set.layout = plant.layout();
  set.control_dim = plant.control_dim();
  set.environment = "dfr-pusher";
  DemonstrationCounts seen;
  for (std::uint64_t episode = 0; seen.kept < count; ++episode) {
    if (episode >= 100 && episode > 10 * static_cast<std::uint64_t>(seen.kept + 1)) {
      throw std::runtime_error("the supervisor completes fewer than one episode in ten: " +
                               std::to_string(seen.collided) + " of " + std::to_string(episode) +
                               " collided. Train it again with pusher train-supervisor");
    }
    core::Trajectory trajectory =
        Episode(plant, supervisor, horizon, core::DeriveSeed(seed, {episode}));
    if (trajectory.outcome == core::Outcome::kCollided) {
      ++seen.collided;
    } else if (trajectory.outcome == core::Outcome::kHalted) {
      ++seen.incomplete;
    } else {
      ++seen.kept;
      set.trajectories.push_back(std::move(trajectory));
      if (progress) progress(seen.kept);
    }
  }
  set.discarded = seen.collided + seen.incomplete;
  if (counts != nullptr) *counts = seen;
  return set;
}

}  // namespace dfr::apps::pusher
