#include "arm_pose.h"

#include <algorithm>

namespace dfr::sim::internal {

LowPoint FindLowPoint(const PusherPlant::World& world, const Arm& arm) noexcept {
  LowPoint low;
  for (std::size_t i = 0; i < world.parts.size(); ++i) {
    for (const Point& end : {arm.axes[i].a, arm.axes[i].b}) {
      const double z = end[2] - world.parts[i].radius;
      if (z < low.z) low = {z, end, world.model->geom_bodyid[world.parts[i].geom]};
    }
  }
  return low;
}

void ReadAxes(const PusherPlant::World& world, const mjData* d, Arm& arm) noexcept {
  for (std::size_t i = 0; i < world.parts.size(); ++i) {
    const PusherPlant::World::Part& part = world.parts[i];
    const mjtNum* center = d->geom_xpos + 3 * part.geom;
    const mjtNum* frame = d->geom_xmat + 9 * part.geom;
    for (int k = 0; k < 3; ++k) {
      const double half = part.half_length * frame[3 * k + 2];
      arm.axes[i].a[k] = center[k] - half;
      arm.axes[i].b[k] = center[k] + half;
    }
  }
}

void SetArm(const JointAngles& q, mjData* d) noexcept { std::copy(q.begin(), q.end(), d->qpos); }

bool LiftOffTable(const PusherPlant::World& world, mjData* d, JointAngles& q, Arm& arm) noexcept {
  constexpr double kClearance = 1e-4;  // m, margin above the table against rounding errors
  const mjModel* m = world.model.get();
  for (int iteration = 0; iteration < 8; ++iteration) {
    const LowPoint low = FindLowPoint(world, arm);
    if (low.z >= kTableZ) return true;
    JointAngles gradient{};
    double norm = 0.0;
    for (int j = 0; j < PusherPlant::kNumJoints; ++j) {
      if (m->jnt_bodyid[j] > low.body) break;  // later joints of the chain do not move low.body
      const mjtNum* axis = d->xaxis + 3 * j;
      const mjtNum* anchor = d->xanchor + 3 * j;
      gradient[j] =
          axis[0] * (low.position[1] - anchor[1]) - axis[1] * (low.position[0] - anchor[0]);
      norm += gradient[j] * gradient[j];
    }
    if (norm < 1e-9) return false;
    const double gain = (kTableZ - low.z + kClearance) / norm;
    for (int j = 0; j < PusherPlant::kNumJoints; ++j) {
      q[j] = std::clamp(q[j] + gain * gradient[j], m->jnt_range[2 * j], m->jnt_range[2 * j + 1]);
    }
    SetArm(q, d);
    mj_kinematics(m, d);
    ReadAxes(world, d, arm);
  }
  return FindLowPoint(world, arm).z >= kTableZ;
}

}  // namespace dfr::sim::internal
