#include "apps/study/planar/task.h"

#include <algorithm>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/sim/gallery/corridor.h"
#include "dfr/sim/gallery/disc_push.h"

namespace dfr::study::planar {

const std::vector<std::string>& TaskNames() {
  static const std::vector<std::string> names = {"corridor", "push", "push-weak"};
  return names;
}

Task MakeTask(std::string_view name) {
  Task task;
  task.name = name;
  if (name == "corridor") {
    const sim::CorridorOptions options;
    task.plant = std::make_shared<sim::CorridorPlant>(options);
    task.supervisor_noise = 0.5;
    task.degree = 2;
    task.horizon = 200;
    task.raw_gamma = 1.0;
    return task;
  }
  DFR_THROW_UNLESS(name == "push" || name == "push-weak",
                   "unknown planar task '" << name << "'; valid: corridor, push, push-weak");
  task.plant = std::make_shared<sim::DiscPushPlant>();
  task.supervisor_noise = 0.2;
  task.degree = name == "push" ? 3 : 1;
  task.horizon = 120;
  task.raw_gamma = 30.0;
  return task;
}

std::vector<core::Trajectory> Demonstrate(const Task& task, int count, std::uint64_t seed) {
  std::vector<core::Trajectory> demonstrations;
  const std::unique_ptr<core::SimulatedPlant> clone = task.plant->Clone();
  auto& plant = static_cast<sim::GalleryPlant&>(*clone);
  const int n = plant.state_dim();
  const int m = plant.control_dim();
  // Far more attempts than any sensible supervisor needs.
  const int most = 100 * count + 1000;
  for (int attempt = 0; static_cast<int>(demonstrations.size()) < count; ++attempt) {
    DFR_THROW_UNLESS(attempt < most, "the supervisor of " << task.name << " rarely succeeds");
    core::Trajectory trajectory;
    trajectory.seed = core::DeriveSeed(seed, {static_cast<std::uint64_t>(attempt)});
    core::Random random(core::DeriveSeed(trajectory.seed, {1}));
    plant.Reset(trajectory.seed);
    trajectory.states.resize(task.horizon + 1, n);
    trajectory.controls.resize(task.horizon, m);
    plant.Observe(core::Row(trajectory.states, 0));
    int t = 0;
    for (; t < task.horizon && !plant.completed() && !plant.collided(); ++t) {
      const auto u = core::Row(trajectory.controls, t);
      plant.Supervise({}, u);
      for (double& entry : u) {
        entry = std::clamp(entry + task.supervisor_noise * random.Normal(), -1.0, 1.0);
      }
      if (plant.Apply(u) != core::PlantStatus::kOk) break;
      plant.Observe(core::Row(trajectory.states, t + 1));
    }
    if (!plant.completed()) continue;
    trajectory.outcome = core::Outcome::kCompleted;
    trajectory.states.conservativeResize(t + 1, n);
    trajectory.controls.conservativeResize(t, m);
    demonstrations.push_back(std::move(trajectory));
  }
  return demonstrations;
}

}  // namespace dfr::study::planar
