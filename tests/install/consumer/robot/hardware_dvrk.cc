#include <cstdio>

#include "dfr/hardware/psm_driver.h"

// Without a console, a driver reports that and refuses to move.
int main() {
  dfr::dds::Participant participant({.domain = 101});
  dfr::hardware::PsmDriver driver(participant, {.arm = "PSM1"});
  const dfr::hardware::PsmStatus status = driver.Tick();
  std::puts(driver.Explain().c_str());
  return status == dfr::hardware::PsmStatus::kNoConsole &&
                 driver.Arm() == dfr::hardware::PsmStatus::kNoConsole
             ? 0
             : 1;
}
