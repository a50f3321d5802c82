#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <limits>

#include "dfr/sim/pusher/pusher_plant.h"
#include "pusher_world.h"
#include "segments.h"

namespace dfr::sim::internal {

/// Height of the table in the world.
inline constexpr double kTableZ = -0.325;

using JointAngles = std::array<double, PusherPlant::kNumJoints>;

/// Capsule axes of the arm's parts.
struct Arm {
  static constexpr int kMaxParts = 6;
  std::array<Segment, kMaxParts> axes;
};

/// Reads the axes in the pose of the last mj_kinematics().
void ReadAxes(const PusherPlant::World& world, const mjData* d, Arm& arm) noexcept;

void SetArm(const JointAngles& q, mjData* d) noexcept;

/// The lowest point of the arm.
struct LowPoint {
  double z = std::numeric_limits<double>::infinity();
  Point position{};
  int body = 0;
};

[[nodiscard]] LowPoint FindLowPoint(const PusherPlant::World& world, const Arm& arm) noexcept;

/// Changes `q` by the smallest joint angles (Gauss-Newton on the height of the lowest point) that
/// keep the arm above the table: a compliant arm slides along it. Returns false if the joint limits
/// do not allow it. `d` and `arm` receive the kinematics of the last `q`.
bool LiftOffTable(const PusherPlant::World& world, mjData* d, JointAngles& q, Arm& arm) noexcept;

}  // namespace dfr::sim::internal
