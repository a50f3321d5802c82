#include <cstdio>

#include "dfr/hardware/psm_driver.h"

// Where there is no console, a driver says so and refuses to move anything.
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
