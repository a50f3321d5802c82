#include <benchmark/benchmark.h>

#include <array>
#include <vector>

#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::sim {
namespace {

LineTrackingOptions Options(Observation observation) {
  LineTrackingOptions options;
  options.observation = observation;
  options.disturbance.wave = Wave::kRandom;
  return options;
}

// One control with its settling and all collision checks, without a picture. Argument: size of the
// control in thousandths of the maximum.
void BM_Control(benchmark::State& state) {
  LineTrackingPlant plant(Options(Observation::kGroundTruth));
  plant.Reset(1);
  double u = static_cast<double>(state.range(0)) / 1000.0;
  for (auto _ : state) {
    u = -u;
    const std::array<double, 2> control = {u, 0.5 * u};
    if (plant.Apply(control) != core::PlantStatus::kOk)
      state.SkipWithError("the plant reports a fault");
  }
}
BENCHMARK(BM_Control)->ArgName("u/1000")->Arg(10)->Arg(500)->Arg(1000);

void BM_Render(benchmark::State& state) {
  LineTrackingPlant plant(Options(Observation::kGroundTruth));
  std::vector<std::uint8_t> picture(plant.endoscope().image_size());
  for (auto _ : state) plant.RenderEndoscope(picture);
}
BENCHMARK(BM_Render)->Unit(benchmark::kMillisecond);

// Time of vision per frame. The pictures differ in their noise, like a sensor's pictures.
void BM_Vision(benchmark::State& state) {
  LineTrackingPlant plant(Options(Observation::kVision));
  plant.Reset(1);
  vision::LineVisionOptions options;
  options.target = LineTrackingPlant::target();
  options.p_cam_target = LineTrackingPlant::p_world_cam().inverse();
  vision::LineVision vision(LineTrackingPlant::true_camera(), options);
  std::array<std::vector<std::uint8_t>, 2> pictures;
  for (auto& picture : pictures) {
    plant.Look();
    picture.resize(plant.endoscope().image_size());
    plant.RenderEndoscope(picture);
  }
  const Eigen::Isometry3d cam_from_world = LineTrackingPlant::p_world_cam().inverse();
  const Eigen::Hyperplane<double, 3> plane(cam_from_world.linear() * Eigen::Vector3d::UnitZ(),
                                           cam_from_world * plant.truth().tip_m);
  std::size_t i = 0;
  for (auto _ : state) {
    const auto seen = vision.Observe(plant.endoscope().View(pictures[++i % 2].data()), plane);
    if (!seen.seen()) state.SkipWithError(vision::Name(seen.missing));
  }
}
BENCHMARK(BM_Vision)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace dfr::sim

BENCHMARK_MAIN();
