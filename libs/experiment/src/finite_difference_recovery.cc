#include "dfr/experiment/finite_difference_recovery.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>

#include "dfr/core/contract.h"

namespace dfr::experiment {

FiniteDifferenceRecovery::FiniteDifferenceRecovery(const core::SimulatedPlant& plant,
                                                   const core::DecisionFunction& support,
                                                   double probe_fraction, double step_fraction)
    : plant_(&plant),
      support_(&support),
      probe_fraction_(probe_fraction),
      step_fraction_(step_fraction) {
  DFR_THROW_UNLESS(plant.state_dim() == support.state_dim(),
                   "the plant's state has " << plant.state_dim()
                                            << " entries, but the support takes "
                                            << support.state_dim());
  DFR_THROW_UNLESS(probe_fraction > 0.0 && probe_fraction < 1.0,
                   "probe_fraction must lie in (0, 1), not " << probe_fraction);
  DFR_THROW_UNLESS(step_fraction > 0.0 && step_fraction < 1.0,
                   "step_fraction must lie in (0, 1), not " << step_fraction);
  copy_ = plant.Clone();
  state_.resize(static_cast<std::size_t>(plant.state_dim()));
  gradient_.resize(static_cast<std::size_t>(plant.control_dim()));
}

void FiniteDifferenceRecovery::Reset(std::uint64_t /*seed*/) noexcept {}

double FiniteDifferenceRecovery::DecisionAfter(int t, std::span<const double> u) noexcept {
  copy_->CopyStateFrom(*plant_);
  if (copy_->Apply(u) != core::PlantStatus::kOk) return std::numeric_limits<double>::quiet_NaN();
  copy_->Observe(state_);
  return support_->Decision(t, state_);
}

control::Mode FiniteDifferenceRecovery::Next(const control::RecoverySituation& situation,
                                             std::span<double> u) noexcept {
  if (u.size() != gradient_.size())
    return control::Mode::kHalt;  // The policy belongs to another plant.
  // Uses central differences, because a plant that drifts at zero control would bias forward
  // differences.
  const double h = probe_fraction_ * situation.g / situation.lambda;
  std::fill(u.begin(), u.end(), 0.0);
  double norm_squared = 0.0;
  for (std::size_t i = 0; i < u.size(); ++i) {
    u[i] = h;
    const double ahead = DecisionAfter(situation.t, u);
    u[i] = -h;
    const double behind = DecisionAfter(situation.t, u);
    u[i] = 0.0;
    // Only the direction matters; the division by 2h is omitted.
    gradient_[i] = ahead - behind;
    norm_squared += gradient_[i] * gradient_[i];
  }
  const double norm = std::sqrt(norm_squared);
  if (!(norm > 0.0) || !std::isfinite(norm)) return control::Mode::kHalt;
  const double eta = step_fraction_ * situation.g / situation.lambda;
  for (std::size_t i = 0; i < u.size(); ++i) u[i] = eta * gradient_[i] / norm;
  return control::Mode::kRecovery;
}

}  // namespace dfr::experiment
