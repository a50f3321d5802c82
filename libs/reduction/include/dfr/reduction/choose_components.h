#pragma once

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/trajectory.h"
#include "dfr/kernel/whitened_support.h"

namespace dfr::reduction {

/// Quality of a guard with k components on left-out demonstrations.
struct ComponentsScore {
  int components = 0;  ///< k
  /// Fraction of states inside a kernel::WhitenedSupport.
  double inside = 0.0;
  /// Fraction of the variance of actions that control::LocalFit::NominalControl() explains.
  double explained = 0.0;
  double explained_error = 0.0;  ///< Standard error of `explained` over demonstrations.
  double action_error = 0.0;     ///< Squared error of predicted actions / squared actions.
  /// Squared error of the predicted change of whitened components, J u + drift, as a fraction of
  /// the squared change.
  double response_error = 0.0;
};

/// Options for ChooseComponents().
struct ChooseComponentsOptions {
  /// Numbers of components to try, ascending.
  std::vector<int> candidates = {2, 3, 4, 6, 8, 10, 12, 16, 20, 24, 32, 48};
  /// Number of leading state columns that are not scores. All candidates use them.
  int beside = 0;
  /// Columns of each reduced block, in StateReduction::InOrderOfComponents(). Empty: one block of
  /// all scores.
  std::vector<std::vector<int>> blocks = {};
  /// The components of a block are ActionDirections::Weights() of its scores, found without the
  /// left-out demonstrations, instead of its first scores.
  bool by_actions = false;
  int folds = 5;
  double least_inside = 0.5;  ///< Smallest acceptable fraction of states inside.
  kernel::WhitenedSupportOptions support = {};
  /// Called before and after the fit of each support. Returns false to stop.
  std::function<bool()> going_on = {};
};

/// Result of ChooseComponents().
struct ComponentsChoice {
  std::vector<ComponentsScore> table;  ///< One row for each candidate that was tried, ascending.
  int components = 0;                  ///< The chosen number; 0 if the choice was rejected.
  /// Reason for the choice, or for the rejection with its remedy.
  std::string reason;
  bool stopped = false;  ///< options.going_on or options.support.svm.progress returned false.
};

/// Chooses the number of components by its scores on left-out demonstrations.
///
/// Demonstrations are left out in core::StratifiedFolds(). For each fold and each k, the whitening,
/// the support and the transitions come from the other demonstrations. Fewer than 2000 actions are
/// scored. The scores themselves come from all demonstrations: they do not depend on actions.
///
/// Rule: among the candidates with inside >= least_inside, the smallest k whose explained share is
/// within one standard error of the best (Breiman et al., Classification and Regression Trees,
/// 1984, Sec. 3.4.3). The choice is rejected if no candidate reaches least_inside, or if
/// control::LocalFit::Guesses() is true for the best one. docs/decisions.md gives the reasons.
/// @param demonstrations  scores as states (T + 1 x p), actions as controls (T x m). k components
///   are the first k scores of each block, or all of a shorter block. A candidate is tried only if
///   a block has at least that many scores.
/// @throws std::invalid_argument if there are fewer than four demonstrations, shapes do not match,
///   an entry is not finite, all actions are zero, every candidate exceeds the number of scores of
///   each block, or an option is out of range.
[[nodiscard]] ComponentsChoice ChooseComponents(std::span<const core::Trajectory> demonstrations,
                                                const ChooseComponentsOptions& options = {});

}  // namespace dfr::reduction
