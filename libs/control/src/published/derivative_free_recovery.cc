#include "dfr/control/published/derivative_free_recovery.h"

#include <cmath>
#include <cstddef>

#include "dfr/core/contract.h"

namespace dfr::control {

DerivativeFreeRecovery::DerivativeFreeRecovery(int control_dim, const DfrOptions& options)
    : options_(options) {
  DFR_THROW_UNLESS(control_dim > 0, "control_dim must be positive, not " << control_dim);
  DFR_THROW_UNLESS(options.probe_fraction > 0.0 && options.probe_fraction < 1.0,
                   "probe_fraction must lie in (0, 1), not " << options.probe_fraction);
  DFR_THROW_UNLESS(options.step_fraction > 0.0 && options.step_fraction < 1.0,
                   "step_fraction must lie in (0, 1), not " << options.step_fraction);
  direction_.resize(static_cast<std::size_t>(control_dim));
}

void DerivativeFreeRecovery::Reset(std::uint64_t seed) noexcept {
  random_ = core::Random(seed);
  probing_ = false;
}

Mode DerivativeFreeRecovery::Next(const RecoverySituation& situation,
                                  std::span<double> u) noexcept {
  const double room = situation.g / situation.lambda;
  if (!probing_) {
    random_.Direction(direction_);
    for (std::size_t i = 0; i < u.size(); ++i) {
      u[i] = options_.probe_fraction * room * direction_[i];
    }
    g_before_probe_ = situation.g;
    probing_ = true;
    return Mode::kProbe;
  }

  probing_ = false;
  const double sign = situation.g <= g_before_probe_ ? -1.0 : 1.0;
  double norm_squared = 0.0;
  for (const double entry : direction_) norm_squared += entry * entry;
  // The direction's norm is 1 up to rounding.
  const double scale = sign / std::sqrt(norm_squared);
  for (std::size_t i = 0; i < u.size(); ++i) {
    u[i] = options_.step_fraction * std::abs(room) * (scale * direction_[i]);
  }
  return Mode::kRecovery;
}

}  // namespace dfr::control
