#pragma once

#include "dfr/sim/line_tracking/arm_error.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::apps::line_tracking {

/// A platform that moves at random.
inline sim::LineTrackingOptions Disturbed() {
  sim::LineTrackingOptions options;
  options.disturbance.wave = sim::Wave::kRandom;
  return options;
}

/// The same, observed without a camera.
inline sim::LineTrackingOptions FromTruth() {
  sim::LineTrackingOptions options = Disturbed();
  options.observation = sim::Observation::kGroundTruth;
  return options;
}

/// A perfect calibration: it removes all systematic errors.
inline line_task::LineCalibration Known(const sim::LineTrackingOptions& options) {
  line_task::LineCalibration known;
  known.camera = sim::LineTrackingPlant::true_camera();
  known.p_base_cam =
      sim::LineTrackingPlant::p_world_base().inverse() * sim::LineTrackingPlant::p_world_cam();
  known.arm = sim::ArmError(options.arm).systematic();
  return known;
}

}  // namespace dfr::apps::line_tracking
