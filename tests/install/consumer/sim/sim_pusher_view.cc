#include <cstdint>
#include <vector>

#include "dfr/sim/pusher/pusher_view.h"

// Draws the scene without a display and looks for the green goal.
int main() {
  dfr::sim::PusherPlant plant;
  plant.Reset(1);
  dfr::sim::PusherRenderer renderer(plant, {.width = 160, .height = 120});
  std::vector<std::uint8_t> rgb(3 * 160 * 120);
  renderer.Draw(plant, rgb);
  for (std::size_t i = 0; i < rgb.size(); i += 3) {
    if (rgb[i + 1] > 100 && rgb[i] < rgb[i + 1] / 2 && rgb[i + 2] < rgb[i + 1] / 2) return 0;
  }
  return 1;
}
