#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "dfr/control/guided/task_view.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/features/feature_decision.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/features/features.h"
#include "dfr/core/trajectory.h"
#include "dfr/study/fitted_task.h"

namespace dfr::study {

/// Support estimates for any controller:
///   "raw"           the paper's support: a one-class SVM per time step, on unscaled features
///   "whitened"      guided recovery's support: SVMs of whitened features, pooled over t +- 2
///   "knn-distance"  l = 1 - D / q, D the mean squared distance to the 5 nearest states
///   "density"       l = log p - q, p a Gaussian kernel density
///   "mahalanobis"   l = 1 - (z - m)' S^-1 (z - m) / q
/// The last three use the features and pooling of "whitened". For each time step, q leaves a
/// fraction nu = .05 of the demonstrated states outside. Except for "mahalanobis", the levels of
/// these states are computed without their own demonstration.
inline constexpr std::array<std::string_view, 5> kSupports = {"raw", "whitened", "knn-distance",
                                                              "density", "mahalanobis"};

/// A support of kSupports with all data that controllers need. Immutable; not movable.
class SupportModel {
 public:
  /// `layout` is the layout of the demonstrated states.
  /// @throws std::invalid_argument naming an unknown support and listing the valid ones, or if the
  ///   task has no "raw" support.
  SupportModel(std::string_view name, const FittedTask& fit, const core::StateLayout& layout,
               std::span<const core::Trajectory> demonstrations);
  SupportModel(const SupportModel&) = delete;
  SupportModel& operator=(const SupportModel&) = delete;
  ~SupportModel();

  /// Returns g_t as a function of whole states, not of their features.
  [[nodiscard]] const core::DecisionFunction& decision() const noexcept { return *decision_; }
  [[nodiscard]] const std::vector<double>& lambda() const noexcept { return lambda_; }
  [[nodiscard]] control::TaskView view() const noexcept {
    return {features_, *support_, *levels_, *response_};
  }

 private:
  core::FeatureTransform features_;
  std::unique_ptr<const core::LogDecisionFunction> own_;  // null: the support belongs to the task
  const core::LogDecisionFunction* support_ = nullptr;
  std::optional<control::Levels> levels_;
  std::optional<control::Response> response_;
  std::optional<core::FeatureDecision> decision_;
  std::vector<double> lambda_;
};

}  // namespace dfr::study
