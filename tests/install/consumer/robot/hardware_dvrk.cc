#include "dfr/hardware/psm_driver.h"

// Without a console, a driver refuses to move.
int main() {
  dfr::dds::Participant participant({.domain = 101});
  dfr::hardware::PsmDriver driver(participant, {.arm = "PSM1"});
  return driver.Arm() == dfr::hardware::PsmStatus::kNoConsole ? 0 : 1;
}
