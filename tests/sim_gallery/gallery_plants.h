// Plants of the gallery's tasks, driven by hand.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "dfr/sim/gallery/gallery.h"

namespace dfr::sim {

inline std::unique_ptr<GalleryPlant> Make(const GalleryTask& task) {
  return std::unique_ptr<GalleryPlant>(static_cast<GalleryPlant*>(task.plant->Clone().release()));
}

inline std::vector<double> State(const core::Plant& plant) {
  std::vector<double> x(static_cast<std::size_t>(plant.state_dim()));
  plant.Observe(x);
  return x;
}

inline void Apply(core::Plant& plant, const std::vector<double>& u) {
  ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
}

// Applies the supervisor's controls without noise while `going` holds.
template <typename Condition>
void Supervise(GalleryPlant& plant, Condition going) {
  std::vector<double> u(static_cast<std::size_t>(plant.control_dim()));
  for (int t = 0; t < 1000 && going(State(plant)); ++t) {
    plant.Supervise({}, u);
    Apply(plant, u);
  }
}

}  // namespace dfr::sim
