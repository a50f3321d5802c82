#include <chrono>
#include <string>
#include <thread>

#include "dfr/hardware/psm_driver.h"
#include "dfr/runtime/periodic_timer.h"

namespace dfr::hardware {

BringUpClock BringUpClock::Machine() {
  return {.steady_ns = &runtime::SteadyNow,
          .wall_ns = [] { return dds::Stamp::Now().nanoseconds(); },
          .wait = [] { std::this_thread::sleep_for(std::chrono::milliseconds(5)); }};
}

PsmStatus BringUp(PsmDriver& driver, double timeout_s,
                  const std::function<void(std::string_view)>& say,
                  const std::function<bool()>& may_move, const BringUpClock& clock) {
  const auto tell = [&](std::string_view text) {
    if (say) say(text);
  };
  const auto hold = [&] {
    driver.Hold();
    driver.Tick(clock.steady_ns(), clock.wall_ns());
    driver.Flush();
  };
  const std::int64_t end = clock.steady_ns() + static_cast<std::int64_t>(1e9 * timeout_s);
  // Shorter reasons are not reported: they are normal during discovery, and before the first sample
  // after homing.
  constexpr std::int64_t kPatienceNs = 1'000'000'000;
  PsmStatus told = PsmStatus::kOk;
  PsmStatus seen = PsmStatus::kOk;
  std::int64_t seen_ns = 0;
  bool asked = false;
  for (; clock.steady_ns() < end; clock.wait()) {
    if (may_move && !may_move()) {
      hold();
      return PsmStatus::kHeld;
    }
    driver.Tick(clock.steady_ns(), clock.wall_ns());
    ConsoleMessage message;
    while (driver.TakeMessage(message)) {
      tell(std::string("message from the console (") + Name(message.severity) +
           "): " + std::string(message.view()));
    }
    if (driver.phase() == PsmPhase::kArmed) return PsmStatus::kOk;
    if (driver.phase() == PsmPhase::kRequested) continue;
    if (asked && driver.phase() == PsmPhase::kHolding) return driver.status();
    const PsmStatus reason = driver.client().hold_reason();
    if (reason == PsmStatus::kOk) {
      const PsmStatus armed = driver.Arm();
      if (armed == PsmStatus::kFrameMismatch || armed == PsmStatus::kNotFollowing) return armed;
      continue;
    }
    if ((reason == PsmStatus::kDisabled || reason == PsmStatus::kNotHomed) && !asked) {
      asked = true;
      tell(driver.arm() + ": homing");
      (void)driver.Home();
    } else if (reason == PsmStatus::kConsoleFault || reason == PsmStatus::kPaused ||
               reason == PsmStatus::kUnknownState || reason == PsmStatus::kIncompatible ||
               reason == PsmStatus::kOtherPublisher) {
      return reason;
    } else if (reason != seen) {
      seen = reason;
      seen_ns = clock.steady_ns();
    } else if (reason != told && clock.steady_ns() - seen_ns > kPatienceNs) {
      told = reason;
      tell("waiting: " + driver.Explain());
    }
  }
  if (driver.phase() == PsmPhase::kRequested) {
    hold();
    return PsmStatus::kTimedOut;
  }
  return driver.client().hold_reason() == PsmStatus::kOk ? PsmStatus::kTimedOut
                                                         : driver.client().hold_reason();
}

}  // namespace dfr::hardware
