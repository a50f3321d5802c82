#include "apps/study/planar/task.h"

#include <algorithm>

#include "dfr/core/contract.h"
#include "dfr/core/random.h"
#include "dfr/core/record.h"
#include "dfr/core/text/suggest.h"
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
  if (name != "push" && name != "push-weak") {
    throw core::UnknownName("planar task", name, "corridor, push, push-weak");
  }
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
  // Far more attempts than any sensible supervisor needs.
  const int most = 100 * count + 1000;
  for (int attempt = 0; static_cast<int>(demonstrations.size()) < count; ++attempt) {
    DFR_THROW_UNLESS(attempt < most, "the supervisor of " << task.name << " rarely succeeds");
    const std::uint64_t start = core::DeriveSeed(seed, {static_cast<std::uint64_t>(attempt)});
    core::Random random(core::DeriveSeed(start, {1}));
    plant.Reset(start);
    core::Trajectory trajectory = core::Record(
        plant, task.horizon, [&](int /*t*/, std::span<const double> /*x*/, std::span<double> u) {
          plant.Supervise({}, u);
          for (double& entry : u) {
            entry = std::clamp(entry + task.supervisor_noise * random.Normal(), -1.0, 1.0);
          }
          return plant.Apply(u);
        });
    trajectory.seed = start;
    if (trajectory.outcome == core::Outcome::kCompleted) {
      demonstrations.push_back(std::move(trajectory));
    }
  }
  return demonstrations;
}

}  // namespace dfr::study::planar
