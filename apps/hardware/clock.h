#pragma once

#include <cstdint>

namespace dfr::apps::hardware_app {

/// Clock of a command: the clock of this machine, unless a test overrides it.
class Clock {
 public:
  virtual ~Clock() = default;

  /// Returns the time of a monotonic clock, ns.
  [[nodiscard]] virtual std::int64_t SteadyNs();
  /// Returns the time since the Unix epoch, as in stamps of samples, ns.
  [[nodiscard]] virtual std::int64_t WallNs();
  /// Waits for `seconds`.
  virtual void Wait(double seconds);
};

/// Clock of this machine.
[[nodiscard]] Clock& MachineClock();

/// Evaluates `condition()` every 5 ms until it holds. Returns false after `seconds`.
template <typename Condition>
bool Within(Clock& clock, double seconds, const Condition& condition) {
  const std::int64_t end_ns = clock.SteadyNs() + static_cast<std::int64_t>(1e9 * seconds);
  while (!condition()) {
    if (clock.SteadyNs() > end_ns) return false;
    clock.Wait(0.005);
  }
  return true;
}

}  // namespace dfr::apps::hardware_app
