#include "dfr/kernel/incremental_support.h"

#include <algorithm>
#include <utility>

#include "dfr/core/contract.h"
#include "states_at.h"

namespace dfr::kernel {
namespace {

TimeVaryingSupport FirstFit(const std::vector<core::Matrix>& demonstrations,
                            const TimeVaryingSupportOptions& options,
                            std::vector<FitSummary>& summaries) {
  DFR_THROW_UNLESS(!options.pooled, "a pooled estimate cannot be followed; fit it again instead");
  return TimeVaryingSupport::Fit(demonstrations, options, &summaries);
}

}  // namespace

IncrementalSupport::IncrementalSupport(std::vector<core::Matrix> demonstrations,
                                       const TimeVaryingSupportOptions& options)
    : demonstrations_(std::move(demonstrations)),
      options_(options),
      support_(FirstFit(demonstrations_, options_, summaries_)) {}

void IncrementalSupport::Add(core::Matrix states) {
  std::vector<core::Matrix> demonstrations = demonstrations_;
  demonstrations.push_back(std::move(states));
  internal::CheckDemonstrations(internal::Views(demonstrations));
  // The newcomer begins outside the support vectors.
  std::vector<Eigen::VectorXd> starts;
  for (const FitSummary& summary : summaries_) {
    starts.emplace_back(summary.alpha.size() + 1);
    starts.back() << summary.alpha, 0.0;
  }
  Refit(starts, std::move(demonstrations));
}

void IncrementalSupport::Remove(int index) {
  DFR_THROW_UNLESS(index >= 0 && index < num_demonstrations(),
                   "there is no demonstration " << index << " of " << num_demonstrations());
  DFR_THROW_UNLESS(num_demonstrations() > 2,
                   "an estimate per time step needs at least 2 demonstrations");
  std::vector<core::Matrix> demonstrations = demonstrations_;
  demonstrations.erase(demonstrations.begin() + index);
  std::vector<Eigen::VectorXd> starts;
  for (const FitSummary& summary : summaries_) {
    const Eigen::Index behind = summary.alpha.size() - index - 1;
    starts.emplace_back(summary.alpha.size() - 1);
    starts.back() << summary.alpha.head(index), summary.alpha.tail(behind);
  }
  Refit(starts, std::move(demonstrations));
}

void IncrementalSupport::Refit(const std::vector<Eigen::VectorXd>& starts,
                               std::vector<core::Matrix> demonstrations) {
  const std::vector<internal::StatesView> views = internal::Views(demonstrations);
  const int num_steps =
      options_.num_steps > 0 ? options_.num_steps : internal::LongestLength(views);
  std::vector<OneClassSvm> estimates;
  std::vector<FitSummary> summaries(static_cast<std::size_t>(num_steps));
  for (int t = 0; t < num_steps; ++t) {
    const auto index = static_cast<std::size_t>(t);
    OneClassSvmOptions svm = options_.svm;
    // A new time step continues the last one. A start whose weight has all been removed is none.
    const Eigen::VectorXd& start = starts[std::min(index, starts.size() - 1)];
    if (start.sum() > 0.0) svm.start = core::AsSpan(start);
    estimates.push_back(OneClassSvm::Fit(internal::StatesAt(views, t), svm, &summaries[index]));
  }
  support_ = TimeVaryingSupport(std::move(estimates));
  summaries_ = std::move(summaries);
  demonstrations_ = std::move(demonstrations);
}

}  // namespace dfr::kernel
