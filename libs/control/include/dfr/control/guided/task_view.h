#pragma once

#include "dfr/control/guided/levels.h"
#include "dfr/control/guided/response.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/feature_transform.h"
#include "dfr/core/policy.h"

namespace dfr::control {

/// What guided recovery knows of a task. Borrows all of it; safety::TaskModel owns one.
class TaskView {
 public:
  TaskView(const core::FeatureTransform& features, const core::LogDecisionFunction& support,
           const Levels& levels, const Response& response) noexcept
      : features_(&features), support_(&support), levels_(&levels), response_(&response) {}

  /// z of a state.
  [[nodiscard]] const core::FeatureTransform& features() const noexcept { return *features_; }
  /// l_t(z)
  [[nodiscard]] const core::LogDecisionFunction& support() const noexcept { return *support_; }
  [[nodiscard]] const Levels& levels() const noexcept { return *levels_; }
  [[nodiscard]] const Response& response() const noexcept { return *response_; }

 private:
  const core::FeatureTransform* features_;
  const core::LogDecisionFunction* support_;
  const Levels* levels_;
  const Response* response_;
};

/// @throws std::invalid_argument if parts of `task` do not fit each other.
void CheckFits(const TaskView& task);
/// @throws std::invalid_argument if parts of `task` or the sizes of a policy do not fit, or there
///   are more than kMaxStepEntries features or control entries.
void CheckFits(const core::Policy& policy, const TaskView& task);

}  // namespace dfr::control
