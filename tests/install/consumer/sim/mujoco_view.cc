#include <dfr/sim/mujoco/mujoco_model.h>
#include <dfr/sim/mujoco_view/mujoco_view.h>

#include <stdexcept>

// Succeeds if the library rejects a camera that is not in the model.
int main() try {
  const dfr::sim::MjModelPtr model = dfr::sim::LoadMujocoModel("<mujoco/>", "empty");
  const dfr::sim::MujocoRenderer renderer(*model, {.camera = "none"});
  return 1;
} catch (const std::invalid_argument&) {
  return 0;
}
