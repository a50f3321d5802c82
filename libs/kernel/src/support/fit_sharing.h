#pragma once

#include <functional>
#include <mutex>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/time_varying_support.h"
#include "problems/small_problem.h"
#include "support/states_at.h"

namespace dfr::kernel::internal {

/// Same as OneClassSvm::Fit(), with the memory of `scratch`. The bits of the result depend on
/// whether `scratch` has distances, but not on previous fits.
OneClassSvm FitSharing(const core::Matrix& samples, const OneClassSvmOptions& options,
                       Scratch& scratch, FitSummary* summary);

/// Progress callback of fits that share `progress`, which must outlive this object. Calls do not
/// overlap. After the first false, it returns false without a call.
class SharedProgress {
 public:
  using Callback = std::function<bool(const FitProgress&)>;

  explicit SharedProgress(const Callback& progress) : progress_(progress) {}

  /// Empty if `progress` is. Borrows this object.
  [[nodiscard]] Callback callback() {
    if (!progress_) return {};
    return [this](const FitProgress& progress) {
      const std::lock_guard lock(mutex_);
      goes_on_ = goes_on_ && progress_(progress);
      return goes_on_;
    };
  }

 private:
  const Callback& progress_;
  std::mutex mutex_;
  bool goes_on_ = true;
};

struct NuGamma {
  double nu;
  double gamma;
};

/// Same as TimeVaryingSupport::Fit() for each pair of `grid`, which replaces the values in
/// `options`. Small problems compute the distances between their samples once for the whole grid.
/// If given, `summaries` receives one entry per estimate, pair by pair.
std::vector<TimeVaryingSupport> FitGrid(std::span<const StatesView> demonstrations,
                                        const TimeVaryingSupportOptions& options,
                                        std::span<const NuGamma> grid,
                                        std::vector<FitSummary>* summaries = nullptr);

}  // namespace dfr::kernel::internal
