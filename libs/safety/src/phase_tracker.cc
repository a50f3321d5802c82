#include "phase_tracker.h"

#include <algorithm>
#include <cstdlib>
#include <limits>

namespace dfr::safety::internal {

double PhaseTracker::Follow(std::span<const double> x) noexcept {
  // A step to the side costs little, so that within a wide support the clock decides.
  constexpr double kPenalty = 0.05;
  const int last = support_->num_steps() - 1;
  const int expected = std::min(next_, last);
  double best = -std::numeric_limits<double>::infinity();
  double level = best;
  phase_ = expected;
  for (int q = std::max(0, expected - kWindow); q <= std::min(last, expected + kWindow); ++q) {
    const double l = support_->LogDecision(q, x, {});
    const double score = l - kPenalty * std::abs(q - expected);
    if (score > best) {
      best = score;
      level = l;
      phase_ = q;
    }
  }
  next_ = phase_ + 1;
  return level;
}

}  // namespace dfr::safety::internal
