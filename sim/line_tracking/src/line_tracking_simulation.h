#pragma once

#include <optional>

#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "line_tracking_scene.h"
#include "line_tracking_views.h"

namespace dfr::sim {

/// MuJoCo's positions, which follow from the plant's state, and the cameras that look at them.
struct LineTrackingPlant::Simulation {
  internal::SceneData data;
  std::optional<internal::SceneView> endoscope;  ///< Made when it is needed.
  std::optional<internal::SceneView> outside;    ///< The same.
};

}  // namespace dfr::sim
