#include "pusher_world.h"

#include <algorithm>

#include "dfr/core/contract.h"
#include "dynamic_motion.h"
#include "pusher.xml.h"
#include "quasi_static_step.h"

namespace dfr::sim {
namespace {

void CheckOptions(const PusherOptions& o) {
  DFR_THROW_UNLESS(o.red_y > 0.1 && o.red_y <= 0.3,
                   "PusherOptions: red_y must lie in (0.1, 0.3] m, got " << o.red_y);
  DFR_THROW_UNLESS(o.start_x_min >= 0.42 && o.start_x_min <= o.start_x_max && o.start_x_max <= 0.54,
                   "PusherOptions: need 0.42 <= start_x_min <= start_x_max <= 0.54 m, got "
                       << o.start_x_min << " and " << o.start_x_max);
  DFR_THROW_UNLESS(o.joint_step >= 0.005 && o.joint_step <= 0.1,
                   "PusherOptions: joint_step must lie in [0.005, 0.1] rad, got " << o.joint_step);
  DFR_THROW_UNLESS(o.start_y >= 0.0 && o.start_y <= 0.2,
                   "PusherOptions: start_y must lie in [0, 0.2] m, got " << o.start_y);
  // Distance of a region's centre from the nearest corner of the start area.
  const double dx = 0.64 - o.start_x_max;
  const double dy = std::max(0.0, o.red_y - o.start_y);
  const double apart = PusherPlant::kObjectRadius + PusherPlant::kRedRadius;
  DFR_THROW_UNLESS(dx * dx + dy * dy > apart * apart,
                   "PusherOptions: with start_x_max = "
                       << o.start_x_max << ", start_y = " << o.start_y << ", red_y = " << o.red_y
                       << " m the cylinder can start inside a red region");
}

// The geoms of absent prongs stay in the model, invisible and without contacts.
void ApplyGripper(Gripper gripper, mjModel& model) {
  const bool fork = gripper == Gripper::kFork;
  const double half_width = fork ? 0.07 : gripper == Gripper::kWideBar ? 0.05 : 0.025;
  const int bar = MujocoId(model, mjOBJ_GEOM, "bar");
  model.geom_size[3 * bar + 1] = half_width;
  model.geom_rbound[bar] = half_width + model.geom_size[3 * bar];
  if (fork) return;
  for (const char* name : {"prong_left", "prong_right"}) {
    const int prong = MujocoId(model, mjOBJ_GEOM, name);
    model.geom_rgba[4 * prong + 3] = 0.0f;
    model.geom_matid[prong] = -1;
    for (int pair = 0; pair < model.npair; ++pair) {
      if (model.pair_geom1[pair] == prong || model.pair_geom2[pair] == prong) {
        model.pair_margin[pair] = -1.0;  // m, minimum overlap of a contact
      }
    }
  }
}

}  // namespace

PusherPlant::World::World(const PusherOptions& scene) : options(scene) {
  CheckOptions(options);
  internal::InstallMujocoHandlers();
  model = LoadMujocoModel(embedded::kPusherXml, "sim/pusher");
  ApplyGripper(options.gripper, *model);
  if (options.physics == PusherPhysics::kDynamic) internal::MakeDynamic(*model);

  std::vector<const char*> names = {"upper_arm", "forearm", "hand", "bar"};
  if (options.gripper == Gripper::kFork) names.insert(names.end(), {"prong_left", "prong_right"});
  for (const char* name : names) {
    const int geom = MujocoId(*model, mjOBJ_GEOM, name);
    parts.push_back({name, geom, model->geom_size[3 * geom], model->geom_size[3 * geom + 1]});
  }
  tip_site = MujocoId(*model, mjOBJ_SITE, "tip");
  object_body = MujocoId(*model, mjOBJ_BODY, "object");
  object_half_length = model->geom_size[3 * MujocoId(*model, mjOBJ_GEOM, "object") + 1];

  const int goal_geom = MujocoId(*model, mjOBJ_GEOM, "goal");
  std::copy_n(model->geom_pos + 3 * goal_geom, 3, goal.begin());
  const char* red_names[] = {"red_left", "red_right"};
  for (int i = 0; i < 2; ++i) {
    const int geom = MujocoId(*model, mjOBJ_GEOM, red_names[i]);
    mjtNum* center = model->geom_pos + 3 * geom;
    center[1] = i == 0 ? options.red_y : -options.red_y;
    reds[i].a = reds[i].b = {center[0], center[1], center[2]};
    reds[i].b[2] += model->geom_size[3 * geom + 1];
  }

  layout.Add("qpos", kNumJoints);
  layout.Add("tip", 3);
  layout.Add("object", 3);
  layout.Add("goal", 3);
  layout.Add("red", 6);
  layout.Add("tip_tilt", 3);
}

}  // namespace dfr::sim
