#include "scene.h"

#include <mutex>

namespace dfr::sim::internal {
namespace {

constexpr int kMaxGeoms = 256;

}  // namespace

Scene::Scene(const mjModel& the_model) : model(&the_model), data_(mj_makeData(model)) {
  mjv_defaultCamera(&camera);
  mjv_defaultOption(&option);
  mjv_defaultScene(&scene);
  mjr_defaultContext(&context);
  mjv_makeScene(model, &scene, kMaxGeoms);
  // The first context of a process resolves OpenGL's functions for all contexts.
  static std::mutex loading;
  const std::lock_guard lock(loading);
  mjr_makeContext(model, &context, mjFONTSCALE_150);
}

Scene::~Scene() {
  mjr_freeContext(&context);
  mjv_freeScene(&scene);
}

void Scene::Update(const mjData& state) {
  mju_copy(data_->qpos, state.qpos, model->nq);
  mju_copy(data_->mocap_pos, state.mocap_pos, 3 * model->nmocap);
  mju_copy(data_->mocap_quat, state.mocap_quat, 4 * model->nmocap);
  mj_kinematics(model, data_.get());
  mj_comPos(model, data_.get());
  mj_camlight(model, data_.get());
  mjv_updateScene(model, data_.get(), &option, nullptr, &camera, mjCAT_ALL, &scene);
}

}  // namespace dfr::sim::internal
