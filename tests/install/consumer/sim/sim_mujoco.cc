#include <dfr/sim/mujoco/mujoco_model.h>

#include <stdexcept>

// Compiles a model, and refuses invalid text.
int main() {
  if (dfr::sim::LoadMujocoModel("<mujoco/>", "empty") == nullptr) return 1;
  try {
    static_cast<void>(dfr::sim::LoadMujocoModel("<gauze/>", "gauze"));
  } catch (const std::runtime_error&) {
    return 0;
  }
  return 1;
}
