#pragma once

#include <vector>

#include "dfr/control/published/recovery_strategy.h"
#include "dfr/core/random.h"

namespace dfr::control {

/// Options for DerivativeFreeRecovery. Defaults are the constants of the paper's experiments.
struct DfrOptions {
  double probe_fraction = 1.0 / 500.0;  ///< |u_delta| = probe_fraction g_t(x_t) / lambda_t
  double step_fraction = 1.0 / 50.0;    ///< |u_R| = step_fraction |g_t(x_delta)| / lambda_t
};

/// Derivative-Free Recovery (Algorithm 1, lines 5-12). Each iteration applies two controls: a probe
/// u_delta in a uniformly random direction, then a step of size eta along it, or against it if the
/// probe did not raise g.
///
/// The paper requires |u_delta| << g/lambda and 0 < eta < g(x_t)/lambda. The code of its
/// experiments sets both as in DfrOptions, with eta from |g| at the probed state. If lambda is a
/// true bound (LK), Prop. IV.3 holds for any fractions in (0, 1): the probe leaves g(x_delta) >= (1
/// - probe_fraction) g(x_t), and the step leaves at least (1 - step_fraction) g(x_delta). Otherwise
/// a probe may end outside: g(x_delta) < 0. The step then goes back along the probe, and the gate
/// decides in the resulting state.
class DerivativeFreeRecovery final : public RecoveryStrategy {
 public:
  /// @throws std::invalid_argument if control_dim < 1 or an option is out of range.
  DerivativeFreeRecovery(int control_dim, const DfrOptions& options);

  void Reset(std::uint64_t seed) noexcept override;
  [[nodiscard]] Mode Next(const RecoverySituation& situation,
                          std::span<double> u) noexcept override;

 private:
  DfrOptions options_;
  core::Random random_{0};
  bool probing_ = false;
  double g_before_probe_ = 0.0;
  std::vector<double> direction_;
};

}  // namespace dfr::control
