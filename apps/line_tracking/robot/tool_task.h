#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <optional>
#include <span>

#include "dfr/hardware/psm_driver.h"
#include "dfr/kinematics/psm.h"
#include "dfr/line_task/line_task.h"
#include "dfr/robot/devices.h"

namespace dfr::apps::line_tracking {

/// Line tracking as a robot::Task. Controls are displacements of the tool.
class ToolTask final : public robot::Task {
 public:
  ToolTask(const line_task::LineTask& task, const hardware::PsmDriver& driver, double speed_m_s)
      : task_(&task), driver_(&driver), speed_m_s_(speed_m_s) {}

  [[nodiscard]] int state_dim() const noexcept override { return task_->layout().state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  void Begin() noexcept override { command_m_ = task_->Tip(driver_->client().setpoint()); }
  [[nodiscard]] std::optional<robot::Motion> Plan(
      std::span<const double> control) noexcept override {
    const Eigen::Vector3d step = line_task::LineTask::Displacement(control);
    if (!task_->Reading(command_m_ + step, joints_)) return std::nullopt;
    command_m_ += step;
    change_mm_ = {1e3 * step.x(), 1e3 * step.y()};
    // The joints of an upright tool may differ from the set-point by rounding. Even a zero control
    // then causes a motion.
    const hardware::PsmClient& client = driver_->client();
    const double shortest_s = joints_ == client.setpoint() ? 0.0 : client.options().longest_step_s;
    const double duration_s = std::max(step.norm() / speed_m_s_, shortest_s);
    return robot::Motion{{joints_.data(), 6}, duration_s, change_mm_};
  }
  /// Writes joints that hold the tool upright at its position. Returns false if there are none.
  [[nodiscard]] bool Upright(kinematics::PsmJoints& joints) const noexcept {
    return task_->Reading(command_m_, joints);
  }

 private:
  const line_task::LineTask* task_;
  const hardware::PsmDriver* driver_;
  double speed_m_s_;
  Eigen::Vector3d command_m_ = Eigen::Vector3d::Zero();  // tip, world
  kinematics::PsmJoints joints_ = kinematics::PsmJoints::Zero();
  std::array<double, 2> change_mm_{};
};

}  // namespace dfr::apps::line_tracking
