#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <string_view>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/sim/mujoco/mujoco_model.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "segments.h"

namespace dfr::sim {

/// Data that all clones share: the model of one scene and the indices of its parts. Immutable.
struct PusherPlant::World {
  /// A capsule of the arm.
  struct Part {
    std::string_view name;
    int geom = 0;
    double radius = 0.0;
    double half_length = 0.0;
  };

  explicit World(const PusherOptions& scene);

  PusherOptions options;
  MjModelPtr model;
  core::StateLayout layout;
  std::vector<Part> parts;
  int tip_site = 0;
  int object_body = 0;
  internal::Point goal{};
  std::array<internal::Segment, 2> reds{};  ///< Axes of the posts.
  double object_half_length = 0.0;          ///< Half the axis of the cylinder's capsule.
};

/// One simulation. Between calls it is at rest, with zero velocities and current kinematics.
struct PusherPlant::Data {
  MjDataPtr mj;
  std::string_view collided_part;
  bool faulted = false;
  double residual_speed = 0.0;
  PusherStatistics statistics;
};

}  // namespace dfr::sim
