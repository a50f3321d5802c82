#pragma once

#include <span>
#include <string>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety {

/// What speaks against using a guard, each with its remedy: too few demonstrations to tell ways
/// apart, states or predictions of left-out demonstrations that are mostly outside, actions of
/// these that it would change or that features do not tell, an alarm level far outside, an action
/// limit far beyond the demonstrated actions, and GuardSummary::findings. Empty if nothing does.
[[nodiscard]] std::vector<std::string> Warnings(const GuardModel& model);
/// GuardSummary::findings: features that only follow the clock, rotations that jump, actions that
/// explain little of how features change.
[[nodiscard]] std::vector<std::string> Findings(const GuardModel& model,
                                                std::span<const core::Trajectory> demonstrations);

/// In which sense `false_alarms` and the constants of a certificate are promised: exactly or
/// approximately, on average over fits or of this one.
[[nodiscard]] std::string DescribeGuarantee(const GuardSummary& summary);

/// How far a state that raises no alarm may be from all demonstrated ones, in the entries of one
/// block of the state that features look at, and in their unit.
struct Clearance {
  std::string block;     ///< Its name in the layout.
  double largest = 0.0;  ///< Over time steps: |x_b - x_b^(i)| <= largest for a demonstrated x^(i).
  int step = 0;          ///< Where that is.
  double median = 0.0;   ///< Over time steps.
};
/// If demonstrations kept a distance of `largest` from every constraint, no support meets one: the
/// hypothesis of a certificate in the units of the state (kernel::CoverRadius()).
[[nodiscard]] std::vector<Clearance> Clearances(const GuardModel& model);

/// Which entries put each state outside the support: row i has the contribution of each entry of
/// states row i to -l, and sums to it; zeros where GuardModel::Levels() gives l >= 0. A
/// contribution is the rise of l along that entry on the steepest way back to l = 0 in whitened
/// features. It does not depend on the units of the entries. A negative one compensates for others.
/// @throws std::invalid_argument if states are not state_dim() wide.
[[nodiscard]] core::Matrix Attribution(const GuardModel& model, const core::Matrix& states);

}  // namespace dfr::safety
