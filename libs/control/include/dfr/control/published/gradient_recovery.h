#pragma once

#include <Eigen/Core>

#include "dfr/control/guided/support_step.h"
#include "dfr/control/guided/task_view.h"
#include "dfr/control/published/recovery_strategy.h"
#include "dfr/control/response/response_estimate.h"

namespace dfr::control {

/// Guided recovery's step as a RecoveryStrategy, in place of DFR's probes. It ascends from v = 0
/// towards the gate level of the present support, with a J that is updated by the recovery's
/// controls. Each iteration applies one control. Next() returns kHalt if J gives no direction of
/// ascent.
class GradientRecovery final : public RecoveryStrategy {
 public:
  /// Borrows everything that `task` borrows. Each entry of a control is within +- `control_limit`.
  /// @throws std::invalid_argument unless control_limit > 0.
  explicit GradientRecovery(const TaskView& task, double control_limit = 1.0);

  void Reset(std::uint64_t seed) noexcept override;
  [[nodiscard]] Mode Next(const RecoverySituation& situation,
                          std::span<double> u) noexcept override;

 private:
  TaskView task_;
  StepLimits limits_;
  ResponseEstimate estimate_;
  LocalFit fit_;  ///< Fit at the state of the last control.
  Eigen::VectorXd z_;
  Eigen::VectorXd dz_;
  Eigen::VectorXd v_;
};

}  // namespace dfr::control
