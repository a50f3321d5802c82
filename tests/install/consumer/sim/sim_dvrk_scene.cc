#include "dfr/sim/dvrk_scene/dvrk_scene.h"

// An arm at the line's beginning has the pose that its console reports.
int main() {
  dfr::sim::DvrkScene scene({.arm = {.arm = "PSM1"}, .world = {}, .seed = 1});
  scene.Reset(7);
  scene.Step(0.01);
  const bool there = scene.console().measured_joints() == scene.plant().reported_joints();
  return there && scene.console().homed() && !scene.plant().collided() ? 0 : 1;
}
