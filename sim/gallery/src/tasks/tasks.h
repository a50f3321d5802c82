#pragma once

#include <memory>
#include <vector>

#include "dfr/sim/gallery/gallery.h"

namespace dfr::sim::internal {

// Defined in tasks/*.cc, dynamics.cc and paths.cc.
std::vector<GalleryTask> PointTasks();
GalleryTask PushTask();
GalleryTask InsertionTask();
GalleryTask GraspTask();
GalleryTask LidTask();
GalleryTask InertiaTask();
GalleryTask BalanceTask();
GalleryTask CarTask();
GalleryTask Arm2Task();
GalleryTask Arm7Task();
GalleryTask PickTask();
GalleryTask DoorTask();
GalleryTask WipeTask();
GalleryTask EightTask();
GalleryTask JointsTask();
GalleryTask ScrewTask();
GalleryTask BimanualTask();
GalleryTask RopeTask();
GalleryTask CrossingTask();

/// Adds Clone() to a plant.
template <typename Derived>
class Cloned : public GalleryPlant {
 public:
  using GalleryPlant::GalleryPlant;
  [[nodiscard]] std::unique_ptr<core::SimulatedPlant> Clone() const final {
    return std::make_unique<Derived>(static_cast<const Derived&>(*this));
  }
};

}  // namespace dfr::sim::internal
