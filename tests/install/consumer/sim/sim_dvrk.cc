#include "dfr/sim/dvrk/psm_console.h"

// An arm needs time for homing.
int main() {
  dfr::sim::PsmConsole console({.arm = "PSM1", .homing_s = 0.5});
  console.StateCommand("home");
  for (int i = 0; i < 100; ++i) console.Step(0.01);
  return console.homed() && !console.busy() ? 0 : 1;
}
