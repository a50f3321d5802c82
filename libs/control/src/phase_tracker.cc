#include "dfr/control/phase_tracker.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

namespace dfr::control {
namespace {

// PhaseTracker::Fit() then takes every level.
constexpr double kAny = -std::numeric_limits<double>::infinity();

}  // namespace

void PhaseTracker::Reset(int first) noexcept {
  phase_ = first;
  expected_ = first;
  waited_ = 0;
}

void PhaseTracker::Advance() noexcept {
  ++phase_;
  waited_ = 0;
}

void PhaseTracker::Advance(std::span<const double> z, bool may_wait) noexcept {
  const int before = phase_;
  const int first = before + (may_wait ? 0 : 1);
  const int last = std::max(first, std::min(before + kWindow, support_->num_steps() - 1));
  phase_ = first;  // Where there is no level at all.
  static_cast<void>(Fit(z, first, last, before + 1, kAny));
  waited_ = phase_ == before ? waited_ + 1 : 0;
}

double PhaseTracker::Follow(std::span<const double> z) noexcept {
  const int last = support_->num_steps() - 1;
  const int expected = std::min(expected_, last);
  phase_ = expected;
  const double l =
      Fit(z, std::max(0, expected - kWindow), std::min(last, expected + kWindow), expected, kAny);
  expected_ = phase_ + 1;
  return l;
}

double PhaseTracker::Enter(std::span<const double> z, double least) noexcept {
  // A certified control ends inside a phase near the one it was chosen at, which is one less than
  // phase_ if that has advanced.
  const double l = Fit(z, std::max(0, phase_ - kWindow - 1), phase_ + kWindow, phase_, least);
  return l >= least ? l : support_->LogDecision(phase_, z, {});
}

double PhaseTracker::Fit(std::span<const double> z, int first, int last, int expected,
                         double least) noexcept {
  // A phase to the side costs little, so that within a wide support the clock decides.
  constexpr double kPenalty = 0.05;
  constexpr double kNowhere = -std::numeric_limits<double>::infinity();
  double best = kNowhere;
  double level = kNowhere;
  for (int q = first; q <= last; ++q) {
    const double l = support_->LogDecision(q, z, {});
    const double score = l - kPenalty * std::abs(q - expected);
    if (score > best && l >= least) {
      best = score;
      level = l;
      phase_ = q;
    }
  }
  return level;
}

}  // namespace dfr::control
