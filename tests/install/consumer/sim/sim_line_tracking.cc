#include <array>

#include "dfr/sim/line_tracking/line_tracking_plant.h"

// Takes a picture and detects its features.
int main() {
  dfr::sim::LineTrackingPlant plant;
  plant.Reset(1);
  const bool applied = plant.Apply(std::array{0.5, 0.0}) == dfr::core::PlantStatus::kOk;
  return applied && plant.last_observation().seen() ? 0 : 1;
}
