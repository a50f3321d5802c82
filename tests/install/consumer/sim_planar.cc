#include <array>

#include "dfr/sim/planar/corridor.h"

int main() {
  dfr::sim::CorridorPlant plant;
  plant.Reset(1);
  const std::array<double, 2> still{};
  return plant.Apply(still) == dfr::core::PlantStatus::kOk && !plant.collided() ? 0 : 1;
}
