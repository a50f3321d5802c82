#pragma once

#include "dfr/control/constants.h"
#include "dfr/control/controller.h"

namespace dfr::control {

/// Progress of an episode.
struct Progress {
  double time = 0.0;  ///< Consumed time steps; may be fractional.
  int controls = 0;   ///< Number of applied controls of any kind.
  int waited = 0;     ///< Number of controls since the phase last advanced.
  int away = 0;       ///< Number of consecutive controls that led away from demonstrations.
};

/// Limits of an episode. The first limit reached is the cause of the halt.
struct HaltRule {
  int horizon = 100;        ///< T > 0: kTimeUp after T time steps.
  int max_controls = 1200;  ///< > 0: kIterationLimit after this many controls.
  /// > 0: kNoProgress after this many controls in one phase. Later controls rarely help, and each
  /// of them starts outside the support.
  int patience = 12;

  /// Returns kNone while the episode continues. Also returns kNoProgress after guided::kMostAway
  /// consecutive controls that led away from demonstrations.
  [[nodiscard]] HaltCause operator()(const Progress& progress) const noexcept {
    if (progress.time >= horizon) return HaltCause::kTimeUp;
    if (progress.controls >= max_controls) return HaltCause::kIterationLimit;
    const bool stuck = progress.waited >= patience || progress.away >= guided::kMostAway;
    return stuck ? HaltCause::kNoProgress : HaltCause::kNone;
  }
};

}  // namespace dfr::control
