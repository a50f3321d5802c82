#pragma once

#include <span>
#include <string>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety {

/// Returns reasons not to use a guard, each with its remedy: too few demonstrations to separate
/// modes; left-out demonstrations whose states or predictions are mostly outside, whose actions the
/// guard would change, or whose actions the features do not determine; an alarm level far outside;
/// recording conditions that drift; an action limit or a horizon unlike demonstrations; for
/// Strategy::kCertified, predicted effects that err as much as effects are large; and
/// GuardSummary::fit_warnings.
[[nodiscard]] std::vector<std::string> Warnings(const GuardModel& model);
/// Returns GuardSummary::fit_warnings: entries of an action that are not steered, features that
/// only follow a clock or repeat others, rotations that jump, actions that take effect later or
/// explain little of the change of features, robots that rest under ordinary actions, and opposite
/// actions at the same place. A fit adds a warning about omitted features.
[[nodiscard]] std::vector<std::string> FitWarnings(
    const GuardModel& model, std::span<const core::Trajectory> demonstrations);

/// Describes the guarantee on `false_alarms` and the constants of a certificate: exact or
/// approximate, and on average over fits or for this fit.
[[nodiscard]] std::string DescribeGuarantee(const GuardSummary& summary);

/// Largest distance of a state without an alarm from the nearest demonstrated state, in one block
/// of the state and in its unit.
struct Clearance {
  std::string block;     ///< Name of the block.
  double largest = 0.0;  ///< For some demonstrated x^(i), |x_b - x_b^(i)| <= largest.
  int step = 0;          ///< Time step of `largest`.
  double median = 0.0;   ///< Median over time steps.
};
/// Returns the clearances of all blocks that features use. If demonstrations kept a distance of
/// `largest` from every constraint, no support contains a state that violates a constraint. This is
/// the assumption of a certificate in the units of the state (kernel::CoverRadius()).
[[nodiscard]] std::vector<Clearance> Clearances(const GuardModel& model);

/// Attributes -l of each state to its entries: row i has one contribution per entry of row i of
/// `states` and sums to -l. The row is zero if GuardModel::Levels() gives l >= 0. A contribution is
/// the rise of l along its entry on the path of steepest ascent to l = 0 in whitened features. It
/// does not depend on the units of the entries. A negative contribution compensates for others. The
/// row is NaN if l is -infinity: the state is immeasurably far outside, or not finite.
/// @throws std::invalid_argument if states are not state_dim() wide.
[[nodiscard]] core::Matrix Attribution(const GuardModel& model, const core::Matrix& states);

/// An entry of a state that contributes to its distance from a support.
struct OutsideEntry {
  int entry = 0;
  double share = 0.0;  ///< Contribution to -l, as in Attribution().
  /// Excess over the demonstrated value, in the unit of the entry; negative if below. The path of
  /// Attribution() removes it.
  double excess = 0.0;
};
/// Returns the entries that contribute to -l of `state` at time step `t`, the largest share first;
/// empty inside. @throws std::invalid_argument if the state is not state_dim() wide.
[[nodiscard]] std::vector<OutsideEntry> OutsideEntries(const GuardModel& model, int t,
                                                       std::span<const double> state);

/// Describes the entries, for example "tip[1] is 0.12 above, tip[0] 0.03 below what was
/// demonstrated at step 7"; "" for none.
[[nodiscard]] std::string Describe(const GuardModel& model, int t,
                                   std::span<const OutsideEntry> entries);

/// The demonstrated state nearest to a state.
struct NearestDemonstration {
  int demonstration = -1;  ///< Index of the demonstration; -1 if there is none.
  int step = 0;            ///< Time step of the demonstrated state.
  double distance = 0.0;   ///< Distance in whitened features.
};
/// Searches time steps within three of `t`, or all of them if `t` is negative. `demonstrations` has
/// one matrix of states per demonstration.
/// @throws std::invalid_argument if `state` or a demonstration is not state_dim() wide, or a
/// demonstrated state is not finite. The message names this state.
[[nodiscard]] NearestDemonstration Nearest(const GuardModel& model, int t,
                                           std::span<const double> state,
                                           std::span<const core::Matrix> demonstrations);

/// Explains a decision of a guard in one sentence: the entries of the state or of the predicted
/// next state that are outside, by how much, and the time step. `state` and `action` are the
/// arguments of Guard::Filter(). Predicts the next state from demonstrations alone. Returns "" for
/// a policy's action that passed. Not for a control loop: allocates and takes about as long as 100
/// decisions.
[[nodiscard]] std::string Explain(const GuardModel& model, const Verdict& verdict,
                                  std::span<const double> state, std::span<const double> action);

/// Decisions of a guard on the actions of a recorded episode.
struct Shadow {
  int actions = 0;             ///< Number of actions of the episode.
  int passed = 0;              ///< Number of actions that Guard::Filter() does not change.
  double change = 0.0;         ///< Sum of Verdict::change over the actions that were changed.
  int first_changed = -1;      ///< Time step of the first action that does not pass, or -1.
  std::string reason = {};     ///< Verdict::reason() at that time step.
  int halted = -1;             ///< Time step of the halt, or -1. No later action passes.
  std::vector<double> micros;  ///< Duration of each call of Filter(), in microseconds.
};
/// Runs `guard` in shadow: Filter() judges each recorded action, and Guard::Applied() reports that
/// this action was applied. A guard that cannot continue after an action other than its result (see
/// Guard::Applied()) halts at the first change.
/// @throws std::invalid_argument if the widths of states or actions differ from the guard's.
[[nodiscard]] Shadow RunInShadow(Guard& guard, const core::Trajectory& episode);

}  // namespace dfr::safety
