#pragma once

#include <mujoco/mujoco.h>

#include <memory>

#include "pusher_world.h"

namespace dfr::sim::internal {

/// MuJoCo's visualisation of one model in the OpenGL context that is current when it is made.
struct Scene {
  explicit Scene(const mjModel& the_model)
      : model(&the_model),
        overhead(mj_name2id(model, mjOBJ_CAMERA, "overhead")),
        data(mj_makeData(model)) {
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
    if (camera.type == mjCAMERA_FIXED && camera.fixedcamid == overhead) FadeArm();
    mjr_render(viewport, &scene, &context);
  }

  // Seen from above the arm's links hide what the gripper does.
  void FadeArm() {
    constexpr mjtNum kAboveGripper = -0.2;  // m
    for (int i = 0; i < scene.ngeom; ++i) {
      if (scene.geoms[i].pos[2] < kAboveGripper) continue;
      scene.geoms[i].rgba[3] *= 0.25f;
      scene.geoms[i].transparent = 1;
    }
  }

  static constexpr int kMaxGeoms = 256;
  const mjModel* model;
  int overhead;  // the camera
  std::unique_ptr<mjData, MjDeleter> data;
  mjvCamera camera;
  mjvOption option;
  mjvScene scene;
  mjrContext context;
};

}  // namespace dfr::sim::internal
