#pragma once

#include "dfr/control/controller.h"

namespace dfr::control {

/// How far an episode has come.
struct Progress {
  double time = 0.0;  ///< Time steps used up, also in parts.
  int controls = 0;   ///< Applied controls of any kind.
  int waited = 0;     ///< Controls since the phase last advanced.
};

/// When an episode ends though nothing is wrong. The first that applies is the cause.
struct HaltRule {
  int horizon = 100;        ///< T > 0: kTimeUp once the time is used up.
  int max_controls = 1200;  ///< > 0: kIterationLimit.
  /// > 0: kNoProgress after so many controls in one phase. What no control has mended by then is
  /// not mended later, and every further control is one outside the support.
  int patience = 12;

  /// kNone while the episode goes on.
  [[nodiscard]] HaltCause operator()(const Progress& progress) const noexcept {
    if (progress.time >= horizon) return HaltCause::kTimeUp;
    if (progress.controls >= max_controls) return HaltCause::kIterationLimit;
    return progress.waited >= patience ? HaltCause::kNoProgress : HaltCause::kNone;
  }
};

}  // namespace dfr::control
