#pragma once

#include <optional>

#include "dfr/robot/devices.h"
#include "dfr/runtime/periodic_timer.h"

namespace dfr::robot {

/// This machine's clocks, and periods of a fixed length. The first Wait() allocates.
class RealTimeClock final : public Clock {
 public:
  /// @param period_s  in [0.0001, 10], s.
  explicit RealTimeClock(double period_s) : period_s_(period_s) {}

  [[nodiscard]] Finding Wait(double dt_s) noexcept override;
  [[nodiscard]] std::int64_t SteadyNs() const noexcept override { return runtime::SteadyNow(); }
  [[nodiscard]] std::int64_t WallNs() const noexcept override { return runtime::WallNow(); }
  [[nodiscard]] std::int64_t MachineNs() const noexcept override { return runtime::SteadyNow(); }

  /// How the loop kept its time; nullptr before the first period.
  [[nodiscard]] const runtime::PeriodicTimer* timer() const noexcept {
    return timer_ ? &*timer_ : nullptr;
  }

 private:
  double period_s_;
  std::optional<runtime::PeriodicTimer> timer_;
};

}  // namespace dfr::robot
