#include "clock.h"

#include <chrono>
#include <thread>

#include "dfr/runtime/periodic_timer.h"

namespace dfr::apps::hardware_app {

std::int64_t Clock::SteadyNs() { return runtime::SteadyNow(); }
std::int64_t Clock::WallNs() { return runtime::WallNow(); }
void Clock::Wait(double seconds) {
  std::this_thread::sleep_for(std::chrono::duration<double>(seconds));
}

Clock& MachineClock() {
  static Clock clock;
  return clock;
}

}  // namespace dfr::apps::hardware_app
