#include "dfr/calibration/calibrate.h"

#include <algorithm>
#include <cstdio>
#include <iostream>
#include <numeric>
#include <stdexcept>

#include "commands.h"
#include "dfr/core/random.h"
#include "dfr/sim/line_tracking/calibration_motion.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

void PrintErrors(const char* name, std::vector<double> errors_mm) {
  std::sort(errors_mm.begin(), errors_mm.end());
  const double mean = std::accumulate(errors_mm.begin(), errors_mm.end(), 0.0) /
                      static_cast<double>(errors_mm.size());
  std::printf("%-22s %6.2f %6.2f %6.2f\n", name, mean, errors_mm[errors_mm.size() * 95 / 100],
              errors_mm.back());
}

}  // namespace

line_task::LineCalibration LoadCalibration(const SceneOptions& scene) {
  if (scene.calibration != kNoCalibration) {
    if (!std::filesystem::exists(scene.calibration)) {
      throw std::runtime_error(
          scene.calibration.string() +
          ": no such file. Run `line_tracking calibrate` first, or go on with --calibration none: "
          "the true camera and an uncorrected arm");
    }
    return line_task::LineCalibration::Load(scene.calibration);
  }
  line_task::LineCalibration known;
  known.camera = sim::LineTrackingPlant::true_camera();
  known.p_base_cam =
      sim::LineTrackingPlant::p_world_base().inverse() * sim::LineTrackingPlant::p_world_cam();
  return known;
}

void RunCalibrate(const CalibrateOptions& options) {
  if (options.held_out < 1) throw std::invalid_argument("--held-out must be positive");
  calibration::CalibrationSummary summary;
  line_task::LineCalibration found =
      CalibratePlant(options.scene.plant, options.frames, options.seed, &summary);
  found.provenance.date = core::Today();
  calibration::Print(std::cout, found, summary);

  sim::LineTrackingOptions still = options.scene.plant;
  still.disturbance.wave = sim::Wave::kNone;
  still.observation = sim::Observation::kGroundTruth;
  sim::LineTrackingPlant plant(still);
  const std::uint64_t seed = core::DeriveSeed(options.seed, {1});
  std::cout << "tip errors at " << options.held_out << " held-out poses [mm]\n"
            << "                         mean   95 %    max\n";
  SceneOptions uncalibrated;
  uncalibrated.calibration = kNoCalibration;
  PrintErrors("arm taken at its word",
              sim::HeldOutTipErrors(plant, LoadCalibration(uncalibrated), options.held_out, seed));
  PrintErrors("calibrated", sim::HeldOutTipErrors(plant, found, options.held_out, seed));
  if (!summary.converged) {
    throw std::runtime_error("the calibration did not converge (" + summary.message +
                             "); nothing was written");
  }
  found.Save(options.out);
  std::cout << options.out.string() << " written\n";
}

}  // namespace dfr::apps::line_tracking
