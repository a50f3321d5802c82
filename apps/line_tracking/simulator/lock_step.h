#pragma once

#include <string>

#include "dfr/hardware/psm_driver.h"
#include "dfr/robot/devices.h"
#include "simulator/simulator_link.h"

namespace dfr::apps::line_tracking {

/// Clock of a robot::ControlLoop on dvrk_simulator --lock-step. A simulator that does not answer
/// causes HoldReason::kArmSilent, or kImageSilent in Look(). After a failed call, later calls fail
/// without a request until Retry(). Calls wait for answers, and may allocate.
class LockStep final : public robot::Clock {
 public:
  /// Borrows both arguments.
  LockStep(SimulatorLink& link, hardware::PsmDriver& driver) : link_(&link), driver_(&driver) {}

  [[nodiscard]] robot::Finding Wait(double dt_s) noexcept override;
  [[nodiscard]] std::int64_t SteadyNs() const noexcept override { return link_->now_ns(); }
  [[nodiscard]] std::int64_t WallNs() const noexcept override { return link_->now_ns(); }
  [[nodiscard]] std::int64_t MachineNs() const noexcept override;
  [[nodiscard]] bool lock_step() const noexcept override { return true; }
  [[nodiscard]] robot::Finding Rest() noexcept override;

  /// Requests a picture.
  [[nodiscard]] robot::Finding Look() noexcept;
  /// Discards the set-points sent so far, because they have expired.
  void Forget() noexcept { setpoints_seen_ = driver_->setpoints_sent(); }
  void Retry() noexcept { lost_ = false; }

 private:
  void Run(double dt_s);
  template <typename F>
  robot::Finding Try(runtime::HoldReason otherwise, const F& ask) noexcept;

  SimulatorLink* link_;
  hardware::PsmDriver* driver_;
  std::uint64_t setpoints_seen_ = 0;
  bool lost_ = false;
  std::string error_;
};

}  // namespace dfr::apps::line_tracking
