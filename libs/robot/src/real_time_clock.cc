#include "dfr/robot/real_time_clock.h"

namespace dfr::robot {

Finding RealTimeClock::Wait(double /*dt_s*/) noexcept {
  // Created at the first call: no periods are missed before the loop begins.
  if (!timer_) timer_.emplace(period_s_, *steady_);
  timer_->Wait();
  return {};
}

}  // namespace dfr::robot
