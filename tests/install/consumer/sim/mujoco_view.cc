#include <dfr/sim/mujoco/mujoco_model.h>
#include <dfr/sim/mujoco_view/mujoco_view.h>

#include <stdexcept>

// A camera not in the model is named before anything is drawn.
int main() {
  const dfr::sim::MjModelPtr model = dfr::sim::LoadMujocoModel("<mujoco/>", "empty");
  try {
    const dfr::sim::MujocoRenderer renderer(*model, {.camera = "none"});
  } catch (const std::invalid_argument&) {
    return 0;
  }
  return 1;
}
