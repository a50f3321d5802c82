#include "dfr/sim/gallery/gallery.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "dfr/core/record.h"
#include "dfr/core/text/suggest.h"
#include "tasks/tasks.h"

namespace dfr::sim {

const std::vector<GalleryTask>& GalleryTasks() {
  static const std::vector<GalleryTask> tasks = [] {
    std::vector<GalleryTask> all = internal::PointTasks();
    for (const auto make :
         {internal::PushTask, internal::InsertionTask, internal::GraspTask, internal::LidTask,
          internal::InertiaTask, internal::BalanceTask, internal::CarTask, internal::Arm2Task,
          internal::Arm7Task, internal::PickTask, internal::DoorTask, internal::WipeTask,
          internal::EightTask, internal::JointsTask, internal::ScrewTask, internal::BimanualTask,
          internal::RopeTask, internal::CrossingTask}) {
      all.push_back(make());
    }
    return all;
  }();
  return tasks;
}

const GalleryTask& FindGalleryTask(std::string_view name) {
  std::string names;
  for (const GalleryTask& task : GalleryTasks()) {
    if (task.name == name) return task;
    names += (names.empty() ? "" : ", ") + task.name;
  }
  throw core::UnknownName("task of the gallery", name, names);
}

core::Trajectory DemonstrateOnce(const GalleryTask& task, std::uint64_t seed) {
  // Noise is correlated over about four steps, like the noise of a human hand.
  constexpr double kMemory = 0.8;
  const double fresh = std::sqrt(1.0 - kMemory * kMemory);
  core::Random random(core::DeriveSeed(seed, {1}));
  const SupervisorVariation variation{.way = random.Uniform(), .offset = random.Normal()};
  const double pace = std::exp(random.Uniform(std::log(task.slowest), std::log(task.fastest)));
  const std::unique_ptr<core::SimulatedPlant> clone = task.plant->Clone();
  auto& plant = static_cast<GalleryPlant&>(*clone);
  plant.Reset(seed);
  std::vector<double> noise(static_cast<std::size_t>(plant.control_dim()), 0.0);
  std::vector<double> spread(noise.size(), task.noise);
  for (std::size_t i = 0; i < task.units.size(); ++i) spread[i] *= task.units[i];
  for (const int entry : task.switches) spread[static_cast<std::size_t>(entry)] = 0.0;
  int pause = 0;
  core::Trajectory trajectory = core::Record(
      plant, task.horizon, [&](int /*t*/, std::span<const double> /*x*/, std::span<double> u) {
        plant.Supervise(variation, u);
        if (task.pause > 0.0 && pause == 0 && random.Uniform() < task.pause) {
          pause = 5 + static_cast<int>(random.Below(26));
        }
        const double scale = pause > 0 ? 0.0 : pace;
        if (pause > 0) --pause;
        for (std::size_t i = 0; i < u.size(); ++i) {
          noise[i] = kMemory * noise[i] + fresh * spread[i] * random.Normal();
          u[i] = std::clamp(scale * (u[i] + noise[i]), -1.0, 1.0);
        }
        return plant.Apply(u);
      });
  trajectory.seed = seed;
  return trajectory;
}

std::vector<core::Trajectory> Demonstrate(const GalleryTask& task, int count, std::uint64_t seed) {
  std::vector<core::Trajectory> demonstrations;
  for (int attempt = 0; std::ssize(demonstrations) < count; ++attempt) {
    if (attempt > 10 * count + 100) {
      throw std::runtime_error("the supervisor of '" + task.name + "' rarely succeeds");
    }
    core::Trajectory trajectory =
        DemonstrateOnce(task, core::DeriveSeed(seed, {static_cast<std::uint64_t>(attempt)}));
    if (trajectory.outcome == core::Outcome::kCompleted && trajectory.num_steps() > 0) {
      demonstrations.push_back(std::move(trajectory));
    }
  }
  return demonstrations;
}

}  // namespace dfr::sim
