#pragma once

#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::apps::line_tracking {

/// Returns options for a platform with a random motion.
inline sim::LineTrackingOptions Disturbed() {
  sim::LineTrackingOptions options;
  options.disturbance.wave = sim::Wave::kRandom;
  return options;
}

/// Returns options for the same world, observed without a camera.
inline sim::LineTrackingOptions FromTruth() {
  sim::LineTrackingOptions options = Disturbed();
  options.observation = sim::Observation::kGroundTruth;
  return options;
}

}  // namespace dfr::apps::line_tracking
