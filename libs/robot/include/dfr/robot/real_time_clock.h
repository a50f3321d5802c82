#pragma once

#include <optional>

#include "dfr/robot/devices.h"
#include "dfr/runtime/periodic_timer.h"

namespace dfr::robot {

/// Fixed-length periods by this machine's clocks. The first Wait() allocates.
class RealTimeClock final : public Clock {
 public:
  /// @param period_s  in [0.0001, 10], s.
  /// @param steady  must outlive this object.
  explicit RealTimeClock(double period_s, runtime::SteadyClock& steady = runtime::MachineClock())
      : period_s_(period_s), steady_(&steady) {}

  [[nodiscard]] Finding Wait(double dt_s) noexcept override;
  [[nodiscard]] std::int64_t SteadyNs() const noexcept override { return steady_->Now(); }
  [[nodiscard]] std::int64_t WallNs() const noexcept override { return runtime::WallNow(); }
  [[nodiscard]] std::int64_t MachineNs() const noexcept override { return steady_->Now(); }

  /// Timing statistics of the loop; nullptr before the first period.
  [[nodiscard]] const runtime::PeriodicTimer* timer() const noexcept {
    return timer_ ? &*timer_ : nullptr;
  }

 private:
  double period_s_;
  runtime::SteadyClock* steady_;
  std::optional<runtime::PeriodicTimer> timer_;
};

}  // namespace dfr::robot
