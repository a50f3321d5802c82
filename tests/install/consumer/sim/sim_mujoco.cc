#include <dfr/sim/mujoco/mujoco_model.h>

// Compiles a model.
int main() { return dfr::sim::LoadMujocoModel("<mujoco/>", "empty") == nullptr ? 1 : 0; }
