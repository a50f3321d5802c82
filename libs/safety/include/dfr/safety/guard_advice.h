#pragma once

#include <span>
#include <string>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety {

/// What speaks against using a guard, each with its remedy: too few demonstrations to tell ways
/// apart, states or predictions of left-out demonstrations that are mostly outside, actions of
/// these that it would change or that features do not tell, an alarm level far outside, an action
/// limit far beyond the demonstrated actions, and GuardSummary::fit_warnings. Empty if nothing
/// does.
[[nodiscard]] std::vector<std::string> Warnings(const GuardModel& model);
/// GuardSummary::fit_warnings: features that only follow the clock, rotations that jump, actions
/// that explain little of how features change.
[[nodiscard]] std::vector<std::string> FitWarnings(
    const GuardModel& model, std::span<const core::Trajectory> demonstrations);

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

/// An entry of a state that puts it outside the support of a time step.
struct OutsideEntry {
  int entry = 0;
  double share = 0.0;  ///< Its part of -l, as in Attribution().
  /// How far it is above what was demonstrated (below, if negative), in its own unit: the way back
  /// inside undoes it.
  double excess = 0.0;
};
/// The entries that put `state` outside the support of time step `t`, those with the largest share
/// first; empty inside. @throws std::invalid_argument if the state is not state_dim() wide.
[[nodiscard]] std::vector<OutsideEntry> OutsideEntries(const GuardModel& model, int t,
                                                       std::span<const double> state);

/// "tip[1] is 0.12 above, tip[0] 0.03 below what was demonstrated at step 7"; "" for none.
[[nodiscard]] std::string Describe(const GuardModel& model, int t,
                                   std::span<const OutsideEntry> entries);

/// Where demonstrations come nearest to a state.
struct NearestDemonstration {
  int demonstration = -1;  ///< Its number; -1 if there is none.
  int step = 0;            ///< The time step at which it does,
  double distance = 0.0;   ///< and how far it then is, in whitened features.
};
/// The nearest demonstrated state is looked for at time steps within three of `t`, or at all of
/// them where `t` is negative. `demonstrations` has one matrix of states for each.
/// @throws std::invalid_argument naming the demonstration or state of another width.
[[nodiscard]] NearestDemonstration Nearest(const GuardModel& model, int t,
                                           std::span<const double> state,
                                           std::span<const core::Matrix> demonstrations);

/// Why a guard decided as it did, in one sentence: what of the state or of the predicted next one
/// is how far outside, at which time step of the demonstrations. `state` and `action` are what
/// Guard::Filter() was given. The next state is predicted from what demonstrations show alone. ""
/// for a policy's action that passed. Not for a control loop: it allocates, and takes as long as
/// some hundred decisions.
[[nodiscard]] std::string Explain(const GuardModel& model, const Verdict& verdict,
                                  std::span<const double> state, std::span<const double> action);

/// What a guard would have done with the actions of a recorded episode.
struct Shadow {
  int actions = 0;             ///< All of the episode's.
  int passed = 0;              ///< Those that Guard::Filter() does not change.
  double change = 0.0;         ///< Sum of Verdict::change over the actions that were changed.
  int first_changed = -1;      ///< Time step of the first action that does not pass, or -1.
  std::string reason = {};     ///< Verdict::reason() there.
  int halted = -1;             ///< Time step of the halt, or -1. No later action passes.
  std::vector<double> micros;  ///< Duration of each call of Filter(), in microseconds.
};
/// Runs `guard` in shadow: Filter() judges each recorded action, and Guard::Applied() tells the
/// guard that this action was applied. A guard that cannot go on from another action than its own
/// (see Guard::Applied()) halts at the first change.
/// @throws std::invalid_argument if states or actions are not as wide as the guard's.
[[nodiscard]] Shadow RunInShadow(Guard& guard, const core::Trajectory& episode);

}  // namespace dfr::safety
