#pragma once

#include <vector>

#include "dfr/control/certified/certificate.h"
#include "dfr/control/guided/support_step.h"

namespace dfr::control {

/// Options for CertifiedController. Those without a comment have the same meaning as in
/// GuidedOptions. With fewer iterations, fewer controls pass.
struct CertifiedOptions {
  int horizon = 100;
  int first_step = 0;
  int max_controls = 1200;
  std::vector<double> control_limit = {1.0};
  /// Largest |u_i| that a correction may choose, for example the largest demonstrated one: eps is
  /// measured for demonstrated controls. A larger learned control keeps its size. Empty:
  /// control_limit.
  std::vector<double> correction_limit = {};
  Certificate certificate = {};

  int iterations = 6;
  /// Number of consecutive recoveries and probes after which the controller halts with kNoProgress.
  /// Other controls, of which small parts may pass, consume their share of the time up to
  /// `horizon`.
  int patience = 12;
  double probe_size = 0.35;
  /// Tries nominal controls of nearby demonstrations where no change of the learned control passes.
  bool demonstrated = true;
};

/// Returns the limits of v, with u = control_unit v.
/// @throws std::invalid_argument unless there is one limit or one per entry of a control.
[[nodiscard]] StepLimits Limits(const CertifiedOptions& options, int control_dim,
                                double control_unit);
/// @throws std::invalid_argument naming the option that is out of range.
void Check(const CertifiedOptions& options);

}  // namespace dfr::control
