#include <array>

#include "dfr/sim/pusher/pusher_plant.h"

int main() {
  dfr::sim::PusherPlant plant;
  plant.Reset(1);
  const std::array<double, 7> still{};
  return plant.Apply(still) == dfr::core::PlantStatus::kOk && !plant.collided() ? 0 : 1;
}
