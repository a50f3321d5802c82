#pragma once

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

  /// Whether it is a guess that a guard does not use: it neither explains how actions vary nor hits
  /// what they have in common.
  [[nodiscard]] bool guesses() const noexcept { return Guesses(explained, error); }
  /// In the gallery's tasks `explained` is .29 and more, the least where each demonstrator has a
  /// pace of its own. Without a part of the state that the demonstrator looks at, a box, a velocity
  /// or a pole, it is .17 and less, and the error .46 and more. A demonstrator whose action is one
  /// and the same but for noise explains nothing, with an error of .2.
  [[nodiscard]] static bool Guesses(double explained, double error) noexcept {
    constexpr double kLeastExplained = 0.2;
    constexpr double kMostError = 0.5;
    return explained < kLeastExplained && error > kMostError;
  }
};

/// Judges up to a thousand actions, each by the support and the transitions of the folds that its
/// demonstration is not in, at the levels of `task`, which is fitted to all demonstrations.
[[nodiscard]] Replay ReplayLeftOut(const Recorded& recorded, const GuardFit& fit,
                                   const control::TaskView& task);

}  // namespace dfr::safety::internal
