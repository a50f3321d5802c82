#pragma once

#include <memory>
#include <vector>

#include "dfr/control/published/derivative_free_recovery.h"
#include "dfr/control/published/recovery_strategy.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/plant.h"

namespace dfr::experiment {

/// Finite-difference oracle, the reference for DFR in the paper's Sec. V-A. It uses the true state
/// of a simulated plant and tries controls on a copy before it applies one, which is impossible on
/// a robot.
///
/// Each iteration applies one control of size eta = step_fraction g_t(x) / lambda_t. Its direction
/// is the gradient of g_t with respect to the control, estimated by central differences with DFR's
/// probe size. The recovery halts if the gradient vanishes or the copy refuses a control.
class FiniteDifferenceRecovery final : public control::RecoveryStrategy {
 public:
  /// Borrows `plant` and `support`. `plant` is the driven plant; it is copied, never modified.
  /// DfrOptions describes the fractions.
  /// @throws std::invalid_argument if the sizes of plant and support differ, or a fraction is not
  ///   in (0, 1).
  FiniteDifferenceRecovery(const core::SimulatedPlant& plant, const core::DecisionFunction& support,
                           double probe_fraction = control::DfrOptions().probe_fraction,
                           double step_fraction = control::DfrOptions().step_fraction);

  void Reset(std::uint64_t seed) noexcept override;
  [[nodiscard]] control::Mode Next(const control::RecoverySituation& situation,
                                   std::span<double> u) noexcept override;

 private:
  [[nodiscard]] double DecisionAfter(int t, std::span<const double> u) noexcept;

  const core::SimulatedPlant* plant_;
  const core::DecisionFunction* support_;
  double probe_fraction_;
  double step_fraction_;
  std::unique_ptr<core::SimulatedPlant> copy_;
  std::vector<double> state_;
  std::vector<double> gradient_;
};

}  // namespace dfr::experiment
