#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "dfr/core/decision_function.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/features.h"
#include "dfr/core/folds.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/action_space.h"
#include "dfr/safety/task_model.h"

namespace dfr::safety::internal {

/// l of each state, at the time step that control::PhaseTracker takes it to be in; `steps`, if
/// given, receives those.
std::vector<double> Follow(const core::LogDecisionFunction& support, const core::Matrix& states,
                           std::vector<int>* steps);

/// Whether more points between ways are inside than a fit should allow.
bool TooManyInGaps(const kernel::GapTest& gaps);

/// Demonstrations, put in order and whitened once.
struct Recorded {
  Recorded(const core::FeatureSelection& selection,
           std::span<const core::Trajectory> demonstrations, const ActionSpace& actions);

  std::vector<std::size_t> order;         ///< core::ContentOrder() of the demonstrations.
  std::vector<core::Trajectory> ordered;  ///< The demonstrations in it.
  /// `ordered` with the steered entries of actions in their units.
  std::vector<core::Trajectory> measured;
  core::FeatureTransform features;     ///< Whitens all of them.
  std::vector<core::Matrix> points;    ///< Their features, in the order of recording.
  std::vector<core::Matrix> in_order;  ///< The same in `order`.
};

/// What supports make of demonstrations that they have not seen.
struct HeldOut {
  std::vector<double> worst;  ///< -l at the worst state of each demonstration
  double inside = 0.0;        ///< States.
  double states = 0.0;
  int inside_throughout = 0;

  void Add(const core::LogDecisionFunction& support, const core::Matrix& points);
};

/// The support that a guard is to have, and what fits without some demonstrations make of these.
struct TaskFit {
  kernel::WhitenedSupportOptions options;  ///< gamma and window_share as the tests ask for them.
  kernel::WhitenedSupport to_all;          ///< Fitted to all demonstrations with `options`.
  kernel::GapTest gaps;                    ///< Of `to_all`.
  HeldOut left_out;                        ///< In core::StratifiedFolds().
  HeldOut contiguous;                      ///< In core::ContiguousFolds().
  core::Folds folds;                       ///< Those of `left_out`,
  /// and the support without each; none where fewer than two demonstrations remain.
  std::vector<std::optional<kernel::WhitenedSupport>> without;
};

/// Chooses gamma by the gap test and window_share by demonstrations left out, as GuardOptions says.
/// @returns nothing if `going_on` says so.
std::optional<TaskFit> FitTask(const Recorded& recorded,
                               const kernel::WhitenedSupportOptions& options, int folds,
                               const std::function<bool(std::string_view, double)>& going_on);

/// The task model of these demonstrations; `measured` are the same with ActionSpace::Measured()
/// actions.
std::shared_ptr<const TaskModel> MakeTask(const core::FeatureSelection& selection,
                                          std::span<const core::Trajectory> demonstrations,
                                          std::span<const core::Trajectory> measured,
                                          const kernel::WhitenedSupportOptions& options);

/// The task model of all demonstrations. `to_all` is the support that `options` fit to them.
std::shared_ptr<const TaskModel> MakeTask(const Recorded& recorded, kernel::WhitenedSupport to_all,
                                          const kernel::WhitenedSupportOptions& options);

}  // namespace dfr::safety::internal
