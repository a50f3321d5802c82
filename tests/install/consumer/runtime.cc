#include "dfr/runtime/fail_safe.h"

// A robot in doubt does not move.
int main() {
  using dfr::runtime::Doubt;
  dfr::runtime::FailSafe machine({});
  machine.Tick(1);
  if (!machine.Arm() || !machine.Start() || !machine.may_move()) return 1;
  machine.Doubted(Doubt::kImageOld);
  return machine.may_move() ? 1 : 0;
}
