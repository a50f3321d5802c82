#pragma once

#include <mujoco/mujoco.h>

#include <memory>

#include "pusher_world.h"

namespace dfr::sim::internal {

/// MuJoCo's visualisation of one model in the OpenGL context that is current when it is made.
struct Scene {
  explicit Scene(const mjModel& the_model) : model(&the_model), data(mj_makeData(model)) {
    mjv_defaultCamera(&camera);
    mjv_defaultOption(&option);
    mjv_defaultScene(&scene);
    mjr_defaultContext(&context);
    mjv_makeScene(model, &scene, kMaxGeoms);
    mjr_makeContext(model, &context, mjFONTSCALE_150);
  }
  ~Scene() {
    mjr_freeContext(&context);
    mjv_freeScene(&scene);
  }
  Scene(const Scene&) = delete;
  Scene& operator=(const Scene&) = delete;

  /// Draws the positions of `state` into the current buffer. A plant computes the poses that it
  /// needs; cameras and lights are placed here, in data of our own.
  void Draw(const mjData& state, const mjrRect& viewport) {
    mju_copy(data->qpos, state.qpos, model->nq);
    mj_kinematics(model, data.get());
    mj_comPos(model, data.get());
    mj_camlight(model, data.get());
    mjv_updateScene(model, data.get(), &option, nullptr, &camera, mjCAT_ALL, &scene);
    mjr_render(viewport, &scene, &context);
  }

  static constexpr int kMaxGeoms = 256;
  const mjModel* model;
  std::unique_ptr<mjData, MjDeleter> data;
  mjvCamera camera;
  mjvOption option;
  mjvScene scene;
  mjrContext context;
};

}  // namespace dfr::sim::internal
