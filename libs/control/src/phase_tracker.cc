#include "dfr/control/phase_tracker.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

namespace dfr::control {
namespace {

constexpr double kNowhere = -std::numeric_limits<double>::infinity();
// Makes PhaseTracker::Fit() accept every level.
constexpr double kAny = kNowhere;

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

void PhaseTracker::Advance(std::span<const double> z, double l, bool may_wait) noexcept {
  const int before = phase_;
  const int next = before + 1;
  const int last = support_->num_steps() - 1;
  phase_ = may_wait ? before : next;  // Result if no level is finite.
  double best = kNowhere;
  if (next <= last) Take(next, next, l, best);
  if (may_wait) Take(before, next, support_->LogDecision(before, z, {}), best);
  for (int q = next + 1; q <= std::min(before + kWindow, last); ++q) {
    Take(q, next, support_->LogDecision(q, z, {}), best);
  }
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
  // A certified control ends inside a support near the phase in which it was chosen. This phase is
  // phase_ - 1 if the tracker has advanced since.
  const double l = Fit(z, std::max(0, phase_ - kWindow - 1), phase_ + kWindow, phase_, least);
  return l >= least ? l : support_->LogDecision(phase_, z, {});
}

bool PhaseTracker::Relocate(std::span<const double> z) noexcept {
  double best = 0.0;
  int found = -1;
  for (int q = 0; q < support_->num_steps(); ++q) {
    const double l = support_->LogDecision(q, z, {});
    if (!(l >= best)) continue;
    best = l;
    found = q;
  }
  if (found < 0) return false;
  phase_ = found;
  waited_ = 0;
  return true;
}

bool PhaseTracker::Take(int q, int expected, double l, double& best) noexcept {
  const double score = l - kPenalty * std::abs(q - expected);
  if (!(score > best)) return false;
  best = score;
  phase_ = q;
  return true;
}

double PhaseTracker::Fit(std::span<const double> z, int first, int last, int expected,
                         double least) noexcept {
  double best = kNowhere;
  double level = kNowhere;
  for (int q = first; q <= last; ++q) {
    const double l = support_->LogDecision(q, z, {});
    if (l >= least && Take(q, expected, l, best)) level = l;
  }
  return level;
}

}  // namespace dfr::control
