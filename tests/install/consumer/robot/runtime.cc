#include "dfr/runtime/fail_safe.h"

// A robot with a reason to hold does not move.
int main() {
  using dfr::runtime::HoldReason;
  dfr::runtime::FailSafe machine({});
  machine.Tick(1);
  if (!machine.Arm() || !machine.Start() || !machine.may_move()) return 1;
  machine.Hold(HoldReason::kImageOld);
  return machine.may_move() ? 1 : 0;
}
