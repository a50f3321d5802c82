// Control steps per second of CPU time on one core. The budget is 15000 with contact.
#include <benchmark/benchmark.h>

#include <array>
#include <memory>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/sim/pusher/pusher_plant.h"

namespace dfr::sim {
namespace {

using Control = std::array<double, 7>;

// Opens the elbow and keeps the hand upright: the tip moves straight from home to the goal in 24
// controls, with noise like the supervisor's.
Control Push(int t, double noise, core::Random& random) {
  Control control;
  for (double& u : control) u = noise * random.Normal();
  control[1] += t < 10 ? -0.25 : 0.2;
  control[3] -= 0.75;
  control[5] += 0.75;
  return control;
}

// Prepares start states before the timed loop. From each of them, the timed control moves the
// cylinder.
void BM_Pushing(benchmark::State& state) {
  PusherPlant plant;
  std::vector<std::unique_ptr<core::SimulatedPlant>> starts;
  std::vector<Control> controls;
  core::Random random(1);
  std::vector<double> s(plant.state_dim());
  for (int episode = 0; starts.size() < 1024; ++episode) {
    plant.Reset(episode);
    for (int t = 0; t < 24 && starts.size() < 1024; ++t) {
      const Control control = Push(t, 0.15, random);
      auto before = plant.Clone();
      const double object_x = plant.object_m()[0];
      if (plant.Apply(control) != core::PlantStatus::kOk)
        return state.SkipWithError("the plant reports a fault");
      if (plant.object_m()[0] - object_x < 0.005) continue;
      starts.push_back(std::move(before));
      controls.push_back(control);
    }
  }
  const auto before = plant.statistics();
  std::size_t i = 0;
  for (auto _ : state) {
    plant.CopyStateFrom(*starts[i & 1023]);
    if (plant.Apply(controls[i & 1023]) != core::PlantStatus::kOk) std::abort();
    ++i;
  }
  const auto after = plant.statistics();
  state.counters["controls_per_s"] =
      benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
  state.counters["substeps"] = static_cast<double>(after.substeps - before.substeps) /
                               static_cast<double>(after.simulated - before.simulated);
}
BENCHMARK(BM_Pushing);

// Complete episodes with a noisy push, including resets and observations.
void BM_Episode(benchmark::State& state) {
  PusherPlant plant;
  core::Random random(2);
  std::vector<double> s(plant.state_dim());
  std::int64_t controls = 0;
  for (int episode = 0; auto _ : state) {
    plant.Reset(episode++);
    for (int t = 0; t < 24; ++t) {
      if (plant.Apply(Push(t, 0.3, random)) != core::PlantStatus::kOk) std::abort();
      plant.Observe(s);
      benchmark::DoNotOptimize(s.data());
      ++controls;
    }
  }
  state.counters["controls_per_s"] =
      benchmark::Counter(static_cast<double>(controls), benchmark::Counter::kIsRate);
  state.counters["contact"] = static_cast<double>(plant.statistics().simulated) /
                              static_cast<double>(plant.statistics().controls);
}
BENCHMARK(BM_Episode);

// Controls in free space: kinematics and distances only.
void BM_Free(benchmark::State& state) {
  PusherPlant plant;
  core::Random random(3);
  Control control;
  for (auto _ : state) {
    for (double& u : control) u = random.Uniform(-0.3, 0.3);
    control[1] -= 0.05;
    if (plant.Apply(control) != core::PlantStatus::kOk) std::abort();
  }
  state.counters["controls_per_s"] =
      benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}
BENCHMARK(BM_Free);

void BM_Clone(benchmark::State& state) {
  const PusherPlant plant;
  for (auto _ : state) benchmark::DoNotOptimize(plant.Clone());
}
BENCHMARK(BM_Clone);

}  // namespace
}  // namespace dfr::sim

BENCHMARK_MAIN();
