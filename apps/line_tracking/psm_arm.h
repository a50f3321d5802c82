#pragma once

#include <array>
#include <functional>
#include <string_view>
#include <utility>

#include "dfr/hardware/psm_driver.h"
#include "dfr/line_task/tip_region.h"
#include "dfr/robot/devices.h"

namespace dfr::apps::line_tracking {

/// A PsmDriver as the arm of a robot::ControlLoop; joints are kinematics::PsmJoints. No way is sent
/// on which the tips would leave their region.
class PsmArm final : public robot::Manipulator {
 public:
  /// Borrows `driver` and `region`.
  /// @param on_word  told the console's words in Tick(), so it may not wait; may be empty.
  PsmArm(hardware::PsmDriver& driver, const line_task::TipRegion& region,
         std::function<void(const hardware::ConsoleWord&)> on_word = {})
      : driver_(&driver), region_(&region), on_word_(std::move(on_word)) {}

  [[nodiscard]] robot::Finding Tick(std::int64_t steady_ns, std::int64_t wall_ns) noexcept override;
  [[nodiscard]] bool needs_homing() const noexcept override;
  [[nodiscard]] robot::Finding Home() noexcept override;
  [[nodiscard]] bool homing() const noexcept override {
    return driver_->phase() == hardware::PsmPhase::kRequested;
  }
  [[nodiscard]] robot::Finding Arm() noexcept override;
  void Hold() noexcept override { driver_->Hold(); }
  [[nodiscard]] robot::Finding MoveTo(std::span<const double> joints,
                                      double duration_s) noexcept override;
  [[nodiscard]] bool armed() const noexcept override {
    return driver_->phase() == hardware::PsmPhase::kArmed;
  }
  [[nodiscard]] bool moving() const noexcept override { return driver_->moving(); }
  [[nodiscard]] bool at_rest() const noexcept override { return driver_->at_rest(); }

 private:
  [[nodiscard]] std::string_view SaidBy(std::string_view who) noexcept;

  hardware::PsmDriver* driver_;
  const line_task::TipRegion* region_;
  std::function<void(const hardware::ConsoleWord&)> on_word_;
  hardware::PsmStatus found_ = hardware::PsmStatus::kNoConsole;  // by the last Tick()
  std::array<char, 96> refused_{};
  std::array<char, 96> said_{};
};

}  // namespace dfr::apps::line_tracking
