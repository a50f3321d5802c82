#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <iostream>
#include <stdexcept>

#include "commands/commands.h"
#include "dfr/core/random.h"

namespace dfr::apps::line_tracking {
namespace {

double ThreadSeconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// Moves the tool about the line while the platform moves, and prints the errors of vision.
void PrintRow(const VisionOptions& options, const line_task::LineCalibration& known, double blur_px,
              double light_change, double noise) {
  sim::LineTrackingOptions plant_options = options.scene.plant;
  plant_options.observation = sim::Observation::kVision;
  plant_options.endoscope.blur_px = blur_px;
  plant_options.endoscope.light_change = light_change;
  plant_options.endoscope.noise = noise;
  sim::LineTrackingPlant plant(plant_options, &known);
  core::Random random(options.seed);
  std::vector<double> errors_mm;
  int looks = 0;
  int wrong_sides = 0;
  double render_s = 0.0;
  double look_s = 0.0;
  std::vector<std::uint8_t> picture(plant.endoscope().image_size());
  for (int episode = 0; episode < options.episodes; ++episode) {
    plant.Reset(core::DeriveSeed(options.seed, {static_cast<std::uint64_t>(episode)}));
    const core::Matrix controls = plant.OpenLoopControls(25, 2e-3);
    for (int i = 0; i < 25; ++i) {
      const std::array<double, 2> control = {controls(i, 0) + 0.2 * random.Normal(),
                                             controls(i, 1) + 0.3 * random.Normal()};
      if (plant.Apply(control) != core::PlantStatus::kOk) break;
      const sim::LineTrackingTruth truth = plant.truth();
      if (std::abs(truth.distance_m) > 0.006) break;
      double start = ThreadSeconds();
      plant.RenderEndoscope(picture);
      render_s += ThreadSeconds() - start;
      start = ThreadSeconds();
      plant.Look();
      look_s += ThreadSeconds() - start;
      ++looks;
      const vision::LineObservation& seen = plant.last_observation();
      if (!seen.seen()) continue;
      errors_mm.push_back(1e3 * std::abs(seen.distance_m - truth.distance_m));
      if (std::abs(truth.distance_m) > 3e-4 && seen.distance_m * truth.distance_m < 0)
        ++wrong_sides;
    }
  }
  if (errors_mm.empty()) {
    std::printf("%5.1f %7.2f %6.1f %6d   nothing seen\n", blur_px, light_change, noise, looks);
    return;
  }
  std::sort(errors_mm.begin(), errors_mm.end());
  const auto count = errors_mm.size();
  std::printf("%5.1f %7.2f %6.1f %6d %7.1f%% %7.3f %7.3f %7.3f %6d %9.2f %9.2f\n", blur_px,
              light_change, noise, looks,
              100.0 * static_cast<double>(count) / static_cast<double>(looks), errors_mm[count / 2],
              errors_mm[count * 95 / 100], errors_mm.back(), wrong_sides, 1e3 * render_s / looks,
              1e3 * (look_s - render_s) / looks);
}

}  // namespace

void RunVision(const VisionOptions& options) {
  if (options.episodes < 1) throw std::invalid_argument("--episodes must be positive");
  const line_task::LineCalibration known = LoadCalibration(options.scene);
  std::cout << "errors of the distance to the line [mm], processor time [ms]\n"
               " blur   light  noise  looks    seen  median    95 %     max  wrong    render    "
               "vision\n";
  for (const double blur_px : {0.0, 0.5, 1.0, 2.0, 3.0})
    PrintRow(options, known, blur_px, 0.2, 3.0);
  for (const double light : {0.0, 0.4, 0.6}) PrintRow(options, known, 0.5, light, 3.0);
  for (const double noise : {6.0, 12.0, 20.0}) PrintRow(options, known, 0.5, 0.2, noise);
}

}  // namespace dfr::apps::line_tracking
