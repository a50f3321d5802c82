#include "supervisor/supervisor.h"

#include <stdexcept>
#include <string>
#include <vector>

#include "apps/inputs.h"
#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/core/record.h"

namespace dfr::apps::pusher {
namespace {

// One sampled episode, with the controls that the plant received.
core::Trajectory Episode(sim::PusherPlant& plant, const imitation::GaussianPolicy& supervisor,
                         int horizon, std::uint64_t seed) {
  core::Random random(core::DeriveSeed(seed, {1}));
  const std::uint64_t start = core::DeriveSeed(seed, {0});
  plant.Reset(start);
  core::Trajectory trajectory =
      core::Record(plant, horizon, [&](int /*t*/, std::span<const double> x, std::span<double> u) {
        supervisor.Sample(x, random, u);
        if (plant.Apply(u) != core::PlantStatus::kOk) {
          throw std::runtime_error("the simulation failed while the supervisor demonstrated");
        }
        return core::PlantStatus::kOk;
      });
  trajectory.seed = start;
  return trajectory;
}

}  // namespace

std::filesystem::path ShippedSupervisor(int number) {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  return program.parent_path().parent_path() / "share" / "dfr" / "pusher" /
         (number == 1 ? "supervisor.dfr" : "supervisor_" + std::to_string(number) + ".dfr");
}

std::vector<imitation::GaussianPolicy> LoadShippedSupervisors(int count) {
  DFR_THROW_UNLESS(count >= 1 && count <= kShippedSupervisors,
                   "there are 1 to " << kShippedSupervisors << " supervisors, not " << count);
  std::vector<imitation::GaussianPolicy> supervisors;
  supervisors.reserve(static_cast<std::size_t>(count));
  for (int i = 1; i <= count; ++i) {
    supervisors.push_back(imitation::GaussianPolicy::Load(ShippedSupervisor(i)));
  }
  return supervisors;
}

imitation::GaussianPolicy LoadSupervisor(const std::filesystem::path& file) {
  MustExist(file, "Run `pusher train-supervisor` first, or leave --supervisor out");
  return imitation::GaussianPolicy::Load(file);
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
