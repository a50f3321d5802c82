#include <stdexcept>

#include "dfr/robot/control_loop.h"
#include "dfr/robot/real_time_clock.h"

// A control loop without devices is refused.
int main() try {
  dfr::robot::RealTimeClock clock(0.001);
  const dfr::robot::ControlLoop loop({}, {.clock = &clock});
  return 1;
} catch (const std::invalid_argument&) {
  return 0;
}
