#include <algorithm>

#include "dfr/sim/pusher/pusher_view.h"

// Draws the scene without a display.
int main() {
  const dfr::sim::PusherPlant plant;
  dfr::sim::PusherRenderer renderer(plant, {.width = 160, .height = 120});
  std::vector<std::uint8_t> rgb(3 * 160 * 120);
  renderer.Draw(plant, rgb);
  return std::ranges::max(rgb) > 100 ? 0 : 1;
}
