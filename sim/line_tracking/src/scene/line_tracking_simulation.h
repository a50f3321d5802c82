#pragma once

#include <optional>

#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "scene/line_tracking_scene.h"
#include "scene/line_tracking_views.h"

namespace dfr::sim {

/// MuJoCo's poses, which follow from the plant's state, and MuJoCo's cameras.
struct LineTrackingPlant::Simulation {
  internal::SceneData data;
  std::optional<internal::SceneView> endoscope;  ///< Created on first use.
  std::optional<internal::SceneView> outside;    ///< Created on first use.
};

}  // namespace dfr::sim
