#pragma once

#include <mujoco/mujoco.h>

#include "dfr/sim/mujoco/mujoco_model.h"

namespace dfr::sim::internal {

/// MuJoCo's visualisation of one model in the OpenGL context that is current at construction.
class Scene {
 public:
  explicit Scene(const mjModel& the_model);
  ~Scene();
  Scene(const Scene&) = delete;
  Scene& operator=(const Scene&) = delete;

  /// Places the geoms for the positions of `state`, in the view of `camera`. Computes cameras and
  /// lights from a copy of the positions, because a plant computes neither.
  void Update(const mjData& state);
  void Render(const mjrRect& viewport) { mjr_render(viewport, &scene, &context); }

  const mjModel* model;
  mjvCamera camera;
  mjvOption option;
  mjvScene scene;
  mjrContext context;

 private:
  MjDataPtr data_;
};

}  // namespace dfr::sim::internal
