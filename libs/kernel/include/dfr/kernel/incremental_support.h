#pragma once

#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/kernel/time_varying_support.h"

namespace dfr::kernel {

/// A TimeVaryingSupport that follows its demonstrations: adding or removing one moves every
/// estimate from its last solution to the new one, which is that of a fresh fit within the
/// tolerance. One object belongs to one thread at a time; the supports it returns stay valid.
class IncrementalSupport {
 public:
  /// Options as for TimeVaryingSupport::Fit(); a pooled estimate cannot be followed.
  /// @throws std::invalid_argument as TimeVaryingSupport::Fit(), and if `options.pooled`.
  IncrementalSupport(std::vector<core::Matrix> demonstrations,
                     const TimeVaryingSupportOptions& options);

  /// Appends a demonstration. With num_steps = 0 a longer one than all before adds time steps.
  /// @throws std::invalid_argument if it is empty, of another width, or not finite; nothing changes
  ///   then.
  void Add(core::Matrix states);
  /// Takes demonstration `index` out; those behind it move up. With num_steps = 0 the horizon may
  /// become shorter.
  /// @throws std::invalid_argument if there is none, or fewer than 2 would remain.
  void Remove(int index);

  [[nodiscard]] int num_demonstrations() const noexcept {
    return static_cast<int>(demonstrations_.size());
  }
  [[nodiscard]] const TimeVaryingSupport& support() const noexcept { return support_; }
  /// One entry per estimate, of the last change.
  [[nodiscard]] const std::vector<FitSummary>& summaries() const noexcept { return summaries_; }

 private:
  void Refit(const std::vector<Eigen::VectorXd>& starts, std::vector<core::Matrix> demonstrations);

  std::vector<core::Matrix> demonstrations_;
  TimeVaryingSupportOptions options_;
  std::vector<FitSummary> summaries_;
  TimeVaryingSupport support_;
};

}  // namespace dfr::kernel
