#pragma once

#include <memory>

#include "dfr/sim/gallery/gallery.h"

namespace dfr::sim::internal {

// One function a task or a group of tasks, in the file of that name.
std::vector<GalleryTask> PointTasks();
GalleryTask PushTask();
GalleryTask InertiaTask();
GalleryTask Arm2Task();

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
