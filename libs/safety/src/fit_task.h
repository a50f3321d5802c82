#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "dfr/control/guided/response.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/features.h"
#include "dfr/core/folds.h"
#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/action_space.h"
#include "dfr/safety/task_model.h"

/// How a task model and a guard are fitted: demonstrations are put in order and whitened once, and
/// left out of supports once. All else follows from these fits.
namespace dfr::safety::internal {

/// l of each state, at the time step that control::PhaseTracker takes it to be in; `steps`, if
/// given, receives those.
std::vector<double> Follow(const core::LogDecisionFunction& support, const core::Matrix& states,
                           std::vector<int>* steps);

/// Whether more points between ways are inside than a fit should allow.
bool TooManyInGaps(const kernel::ModeSeparationTest& gaps);

/// The demonstrations that a model is fitted to, in an order that their content decides.
struct Recorded {
  /// Takes those of `demonstrations` that `chosen` names. Controls are ActionSpace::Measured()
  /// where `actions` is given.
  Recorded(const core::FeatureSelection& selection,
           std::span<const core::Trajectory> demonstrations, std::span<const std::size_t> chosen,
           const ActionSpace* actions = nullptr, const core::WhiteningOptions& whitening = {});
  /// The same with features of the caller's own.
  Recorded(core::FeatureTransform transform, std::span<const core::Trajectory> demonstrations,
           std::span<const std::size_t> chosen);

  /// core::StratifiedFolds() and core::ContiguousFolds() of them, `most` at the most.
  [[nodiscard]] core::Folds Stratified(int most) const;
  [[nodiscard]] core::Folds Contiguous(int most) const;

  std::vector<std::size_t> order;         ///< Which demonstration each of the following is.
  std::vector<core::Trajectory> ordered;  ///< With controls as they were recorded.
  core::FeatureTransform features;        ///< Whitens all of them.
  control::FeatureTrajectories seen;      ///< In `features`.
};

/// What supports make of demonstrations that they have not seen.
struct HeldOut {
  std::vector<double> levels;  ///< l of each state,
  std::vector<double> worst;   ///< -l at the worst state of each demonstration.
  int inside_throughout = 0;   ///< Demonstrations.

  void Add(const core::LogDecisionFunction& support, const core::Matrix& points);
  /// The share of states inside.
  [[nodiscard]] double acceptance() const;
};

/// The support that a guard is to have, and what fits without some demonstrations make of these.
struct GuardFit {
  kernel::WhitenedSupportOptions options;  ///< gamma and window_share as the tests ask for them.
  kernel::WhitenedSupport support;         ///< Fitted to all of them with `options`.
  kernel::ModeSeparationTest gaps;         ///< Of `support`.
  core::Folds folds;                       ///< Those of `left_out`,
  /// and the support without each; none where fewer than two demonstrations remain.
  std::vector<std::optional<kernel::WhitenedSupport>> without;
  HeldOut left_out;
  HeldOut contiguous;  ///< In Recorded::Contiguous().
  int support_fits = 0;
};

/// Chooses gamma by the gap test and window_share by demonstrations left out, as GuardOptions says.
/// @returns nothing if `going_on` says so.
std::optional<GuardFit> FitGuard(const Recorded& recorded,
                                 const kernel::WhitenedSupportOptions& options, int folds,
                                 const std::function<bool(std::string_view, double)>& going_on);

/// The task of a support and of what supports make of demonstrations that they have not seen.
TaskParts MakeTask(const Recorded& recorded, kernel::WhitenedSupport support,
                   const HeldOut& left_out, bool single_precision,
                   std::optional<PublishedSupport> published = std::nullopt);

/// The task that `options` ask for, and nothing chosen.
TaskParts FitTask(const core::StateLayout& layout, std::span<const core::Trajectory> demonstrations,
                  const TaskOptions& options);

}  // namespace dfr::safety::internal
