#pragma once

#include <span>

#include "dfr/core/decision_function.h"

namespace dfr::safety::internal {

/// Follows states in order of time through the time steps of a support, as demonstrations and
/// robots go faster or slower than the median: the step whose l_q is largest among those near the
/// one that follows the last. Never allocates.
class PhaseTracker {
 public:
  static constexpr int kWindow = 3;

  /// Borrows the support.
  explicit PhaseTracker(const core::LogDecisionFunction& support) : support_(&support) {}

  void Reset() noexcept { next_ = 0; }
  /// l at the step that state `x` is in, -infinity for a state that is not one.
  double Follow(std::span<const double> x) noexcept;
  /// That step.
  [[nodiscard]] int phase() const noexcept { return phase_; }

 private:
  const core::LogDecisionFunction* support_;
  int phase_ = 0;
  int next_ = 0;
};

}  // namespace dfr::safety::internal
