#pragma once

#include <array>

#include "dfr/sim/line_tracking/arm_error.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::test {

using State = std::array<double, 4>;

inline State Observe(const core::Plant& plant) {
  State x;
  plant.Observe(x);
  return x;
}

/// Returns options of a plant whose states are exact.
inline sim::LineTrackingOptions Truth(sim::Wave wave = sim::Wave::kNone) {
  sim::LineTrackingOptions options;
  options.observation = sim::Observation::kGroundTruth;
  options.disturbance.wave = wave;
  return options;
}

/// Returns the result of a perfect calibration.
inline line_task::LineCalibration PerfectCalibration(const sim::LineTrackingOptions& options) {
  line_task::LineCalibration known;
  known.camera = sim::LineTrackingPlant::true_camera();
  known.p_base_cam =
      sim::LineTrackingPlant::p_world_base().inverse() * sim::LineTrackingPlant::p_world_cam();
  known.arm = sim::ArmError(options.arm).systematic();
  return known;
}

inline core::PlantStatus Apply(core::Plant& plant, double x, double y) {
  return plant.Apply(std::array{x, y});
}

}  // namespace dfr::test
