#pragma once

#include <functional>
#include <optional>
#include <vector>

#include "dfr/control/guided/task_view.h"
#include "dfr/control/response/local_fit.h"
#include "fit/fit_task.h"

namespace dfr::safety::internal {

/// Scores of a guard for actions of held-out demonstrations.
struct Replay {
  /// Fraction of actions that strategy kGuard would change, with Levels::prediction_error() of the
  /// task.
  double changed = 0.0;
  double below_pass = 0.0;    ///< Fraction of actions predicted to end below Levels::pass().
  double ends_outside = 0.0;  ///< Fraction of actions whose predicted next state is outside.
  /// Absolute differences of l at the predicted and at the observed next states.
  std::vector<double> level_errors = {};
  /// Fraction of the variance of actions that LocalFit::NominalControl() explains; negative
  /// if the mean action predicts better.
  double explained = 1.0;
  double error = 0.0;  ///< Squared error of NominalControl(), relative to the squared actions.
  /// `error` for the entry of the action that varies most.
  double entry_error = 0.0;

  /// Returns true if a guard must not use LocalFit::NominalControl().
  [[nodiscard]] bool guesses() const noexcept {
    return control::LocalFit::Guesses(explained, error);
  }
};

/// Scores fewer than 2000 actions, each with the support and the transitions fitted without its
/// demonstration: without[i] is the support without folds[i]. Uses the levels of `task`, which is
/// fitted to all demonstrations.
/// @returns nothing if `going_on`, which is called for each fold, returns false.
[[nodiscard]] std::optional<Replay> ReplayLeftOut(
    const Recorded& recorded, const core::Folds& folds,
    std::span<const std::optional<kernel::WhitenedSupport>> without, const control::TaskView& task,
    const std::function<bool()>& going_on);

}  // namespace dfr::safety::internal
