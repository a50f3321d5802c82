#pragma once

#include <array>
#include <functional>
#include <string_view>
#include <utility>

#include "dfr/hardware/psm_driver.h"
#include "dfr/robot/devices.h"

namespace dfr::hardware {

/// Checks a straight path through joint space. Returns the reason for a refusal, valid until the
/// next call; empty if the path is allowed. The control loop calls this function, which must not
/// wait, allocate or throw.
using PathCheck = std::function<std::string_view(const kinematics::PsmJoints& from,
                                                 const kinematics::PsmJoints& to)>;

/// A PsmDriver as the arm of a robot::ControlLoop; joints are kinematics::PsmJoints. Sends no path
/// that `check` refuses.
class PsmArm final : public robot::Manipulator {
 public:
  /// Borrows `driver`.
  /// @param on_message  called in Tick() with each console message; must not wait. May be empty.
  PsmArm(PsmDriver& driver, PathCheck check,
         std::function<void(const ConsoleMessage&)> on_message = {})
      : driver_(&driver), check_(std::move(check)), on_message_(std::move(on_message)) {}

  [[nodiscard]] robot::Finding Tick(std::int64_t steady_ns, std::int64_t wall_ns) noexcept override;
  [[nodiscard]] bool needs_homing() const noexcept override;
  [[nodiscard]] robot::Finding Home() noexcept override;
  [[nodiscard]] bool homing() const noexcept override {
    return driver_->phase() == PsmPhase::kRequested;
  }
  [[nodiscard]] robot::Finding Arm() noexcept override;
  void Hold() noexcept override { driver_->Hold(); }
  [[nodiscard]] robot::Finding MoveTo(std::span<const double> joints,
                                      double duration_s) noexcept override;
  [[nodiscard]] bool armed() const noexcept override {
    return driver_->phase() == PsmPhase::kArmed;
  }
  [[nodiscard]] bool moving() const noexcept override { return driver_->moving(); }
  [[nodiscard]] bool at_rest() const noexcept override { return driver_->at_rest(); }

 private:
  [[nodiscard]] std::string_view SaidBy(std::string_view who) noexcept;

  PsmDriver* driver_;
  PathCheck check_;
  std::function<void(const ConsoleMessage&)> on_message_;
  PsmStatus found_ = PsmStatus::kNoConsole;  // result of the last Tick()
  bool has_just_held_ = false;               // true if the last Tick() ended arming or homing
  std::array<char, 96> said_{};
};

}  // namespace dfr::hardware
