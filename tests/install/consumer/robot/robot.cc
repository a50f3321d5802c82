#include "dfr/robot/control_loop.h"
#include "dfr/robot/real_time_clock.h"

// A control loop without devices is refused; a real-time clock waits for its period.
int main() {
  dfr::robot::RealTimeClock clock(0.001);
  const std::int64_t start_ns = clock.SteadyNs();
  if (!clock.Wait(0.001).ok() || clock.SteadyNs() - start_ns < 900'000) return 1;
  try {
    const dfr::robot::ControlLoop loop({}, {.clock = &clock});
    return 1;
  } catch (const std::invalid_argument&) {
    return 0;
  }
}
