#pragma once

#include "dfr/control/guided/levels.h"
#include "dfr/control/response/response.h"
#include "dfr/core/decision_function.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/policy.h"

namespace dfr::control {

/// The parts of a task that guided recovery uses. Borrows them; safety::TaskModel owns them.
class TaskView {
 public:
  TaskView(const core::FeatureTransform& features, const core::LogDecisionFunction& support,
           const Levels& levels, const Response& response) noexcept
      : features_(&features), support_(&support), levels_(&levels), response_(&response) {}

  /// Returns the map from a state to z.
  [[nodiscard]] const core::FeatureTransform& features() const noexcept { return *features_; }
  /// Returns the support, which evaluates l_t(z).
  [[nodiscard]] const core::LogDecisionFunction& support() const noexcept { return *support_; }
  [[nodiscard]] const Levels& levels() const noexcept { return *levels_; }
  [[nodiscard]] const Response& response() const noexcept { return *response_; }

 private:
  const core::FeatureTransform* features_;
  const core::LogDecisionFunction* support_;
  const Levels* levels_;
  const Response* response_;
};

/// @throws std::invalid_argument if the dimensions of the parts of `task` differ.
void CheckFits(const TaskView& task);
/// @throws std::invalid_argument if the dimensions of the parts of `task` or the policy differ, or
/// there are more than kMaxStepEntries features or control entries.
void CheckFits(const core::Policy& policy, const TaskView& task);

}  // namespace dfr::control
