#pragma once

#include "dfr/control/guided/response_estimate.h"
#include "dfr/control/guided/task_view.h"
#include "fit_task.h"

namespace dfr::safety::internal {

/// What a guard makes of the actions of demonstrators that it has not learned from.
struct Replay {
  double changed = 0.0;       ///< Share that strategy kGuard would change.
  double ends_outside = 0.0;  ///< Share whose predicted next state is outside.
  /// Share of the variance of actions that ResponseEstimate::NominalControl() explains; negative if
  /// the mean action is the better guess.
  double explained = 1.0;
  double error = 0.0;  ///< What it misses, squared, as a share of the squared actions.

  /// Whether a guard does not use ResponseEstimate::NominalControl().
  [[nodiscard]] bool guesses() const noexcept {
    return control::ResponseEstimate::Guesses(explained, error);
  }
};

/// Judges up to a thousand actions, each by the support and the transitions of the folds that its
/// demonstration is not in, at the levels of `task`, which is fitted to all demonstrations.
[[nodiscard]] Replay ReplayLeftOut(const Recorded& recorded, const GuardFit& fit,
                                   const control::TaskView& task);

}  // namespace dfr::safety::internal
