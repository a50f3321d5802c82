#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "dfr/control/guided/levels.h"
#include "dfr/control/response/response.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/features/features.h"
#include "dfr/core/matrix.h"
#include "dfr/core/numerics/folds.h"
#include "dfr/core/trajectory.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/action_space.h"
#include "dfr/safety/task_model.h"

/// Fits of task models and guards. They order and whiten the demonstrations once, and
/// cross-validate supports.
namespace dfr::safety::internal {

/// Called with the stage and the completed share of a fit. Returns false to stop it.
using StageCallback = std::function<bool(std::string_view stage, double share)>;

/// Returns l of each state at the phase of control::PhaseTracker. If given, `steps` receives the
/// phases.
std::vector<double> Follow(const core::LogDecisionFunction& support, const core::Matrix& states,
                           std::vector<int>* steps);

/// Returns true if more points between modes are inside than a fit allows.
bool TooManyInGaps(const kernel::ModeSeparationTest& gaps);

/// The demonstrations of a fit, in an order determined by their content.
struct Recorded {
  /// Takes the demonstrations with indices `chosen`. If `actions` is given, `seen` has the controls
  /// of ActionSpace::Measured().
  Recorded(const core::FeatureSelection& selection,
           std::span<const core::Trajectory> demonstrations, std::span<const std::size_t> chosen,
           const ActionSpace* actions = nullptr, const core::WhiteningOptions& whitening = {});
  /// Overload with the caller's features.
  Recorded(core::FeatureTransform transform, std::span<const core::Trajectory> demonstrations,
           std::span<const std::size_t> chosen);

  /// Return core::StratifiedFolds() or core::ContiguousFolds(), at most `most` folds.
  [[nodiscard]] core::Folds Stratified(int most) const;
  [[nodiscard]] core::Folds Contiguous(int most) const;

  std::vector<std::size_t> order;         ///< Index of each demonstration of `ordered`.
  std::vector<core::Trajectory> ordered;  ///< Demonstrations with the recorded controls.
  core::FeatureTransform features;        ///< Whitens all demonstrations.
  control::FeatureTrajectories seen;      ///< Demonstrations in `features`.
};

/// Levels of demonstrations under supports fitted without them.
struct HeldOut {
  std::vector<control::HeldOutLevels> each;  ///< One entry per demonstration.
  std::vector<double> worst;                 ///< -l at the worst state of each demonstration.
  int inside_throughout = 0;                 ///< Number of demonstrations that stay inside.

  void Add(const core::LogDecisionFunction& support, const core::Matrix& points);
  /// Returns l of each state.
  [[nodiscard]] std::vector<double> levels() const;
  /// Returns the fraction of states inside.
  [[nodiscard]] double acceptance() const;
};

/// The support of a guard, and its cross-validation.
struct GuardFit {
  kernel::WhitenedSupportOptions options;  ///< Options with the chosen gamma and window_share.
  kernel::WhitenedSupport support;         ///< Fitted to all demonstrations with `options`.
  kernel::ModeSeparationTest gaps;         ///< Result for `support`.
  core::Folds folds;                       ///< Folds of `left_out`.
  /// The support without each fold; none if fewer than two demonstrations remain.
  std::vector<std::optional<kernel::WhitenedSupport>> without;
  HeldOut left_out;
  HeldOut contiguous;  ///< Levels in Recorded::Contiguous().
  int support_fits = 0;
};

/// Chooses gamma by the mode separation test (with `may_narrow`, also by volume) and window_share
/// by cross-validation; see GuardOptions.
/// @returns nothing if `progress` or options.svm.progress returns false. Neither is called again.
std::optional<GuardFit> FitGuard(const Recorded& recorded,
                                 const kernel::WhitenedSupportOptions& options, int folds,
                                 const StageCallback& progress, bool may_narrow);

/// Creates a task from a support and its cross-validation.
/// @returns nothing if `going_on` returns false. It is not called again.
std::optional<TaskParts> MakeTask(const Recorded& recorded, kernel::WhitenedSupport support,
                                  const HeldOut& left_out, bool single_precision,
                                  const std::function<bool()>& going_on,
                                  std::optional<PublishedSupport> published = std::nullopt);

/// Fits a task with exactly these `options`: chooses neither gamma nor window_share.
TaskParts FitTask(const core::StateLayout& layout, std::span<const core::Trajectory> demonstrations,
                  const TaskOptions& options);

}  // namespace dfr::safety::internal
