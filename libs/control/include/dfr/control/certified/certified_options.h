#pragma once

#include <vector>

#include "dfr/control/certified/certificate.h"
#include "dfr/control/guided/support_step.h"

namespace dfr::control {

/// Options for CertifiedController: what the task says, then constants that are meant for every
/// task. Controls are in units of the demonstrations' root mean square.
struct CertifiedOptions {
  int horizon = 100;        ///< T: time steps of the learned policy in an episode, > 0.
  int first_step = 0;       ///< Time step and phase that an episode begins with, in [0, T).
  int max_controls = 1200;  ///< In an episode, of any kind, > 0.
  /// Each entry of an applied control is within +- this, >= 0: one limit for all, or one each.
  std::vector<double> control_limit = {1.0};
  Certificate certificate = {};

  /// Gradients of l in one step, >= 0. Fewer decide faster and find fewer controls that pass.
  int iterations = 6;
  /// HaltRule::patience
  int patience = 12;
  /// Size of a probe, >= 0: above the noise of observations, below what a wrong direction may cost.
  /// 0: directions of control that nobody has used stay unknown.
  double probe_size = 0.35;
};

/// What its controls have to respect, |u| = control_unit |v|.
/// @throws std::invalid_argument if there are not as many limits as controls.
[[nodiscard]] StepLimits Limits(const CertifiedOptions& options, int control_dim,
                                double control_unit);
/// @throws std::invalid_argument naming the option that is out of range.
void Check(const CertifiedOptions& options);

}  // namespace dfr::control
