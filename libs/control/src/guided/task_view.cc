#include "dfr/control/guided/task_view.h"

#include <algorithm>

#include "dfr/control/guided/support_step.h"
#include "dfr/core/contract.h"

namespace dfr::control {

void CheckFits(const TaskView& task) {
  const int n = task.features().num_features();
  DFR_THROW_UNLESS(n == task.support().state_dim(), "there are "
                                                        << n << " features, but the support takes "
                                                        << task.support().state_dim());
  DFR_THROW_UNLESS(
      n == task.response().feature_dim(),
      "there are " << n << " features, but the response has " << task.response().feature_dim());
}

void CheckFits(const core::Policy& policy, const TaskView& task) {
  CheckFits(task);
  DFR_THROW_UNLESS(policy.state_dim() == task.features().state_dim(),
                   "the policy takes states of " << policy.state_dim()
                                                 << " entries, but the features take "
                                                 << task.features().state_dim());
  DFR_THROW_UNLESS(policy.control_dim() == task.response().control_dim(),
                   "the policy gives " << policy.control_dim()
                                       << " control entries, but demonstrations have "
                                       << task.response().control_dim());
  DFR_THROW_UNLESS(
      std::max(task.features().num_features(), task.response().control_dim()) <= kMaxStepEntries,
      "guided recovery takes at most " << kMaxStepEntries << " features and control entries");
}

}  // namespace dfr::control
