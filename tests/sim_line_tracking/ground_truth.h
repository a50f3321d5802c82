#pragma once

#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::test {

/// Returns options of a plant whose states are exact.
inline sim::LineTrackingOptions Truth(sim::Wave wave = sim::Wave::kNone) {
  sim::LineTrackingOptions options;
  options.observation = sim::Observation::kGroundTruth;
  options.disturbance.wave = wave;
  return options;
}

}  // namespace dfr::test
