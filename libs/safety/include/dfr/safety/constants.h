#pragma once

#include <cstddef>

/// Constants of the fit of a guard that are not options. docs/frozen_constants.md lists them.
namespace dfr::safety::fit {

/// Number of cross-validation folds. Each fold leaves whole demonstrations out.
inline constexpr int kFolds = 5;
/// Maximum number of points that a mode separation test may find inside, as a fraction of its
/// points or of the time steps, whichever is larger. While the test finds more points inside, the
/// fit doubles gamma, at most kMostDoublings times.
inline constexpr double kMostInGaps = 0.05;
inline constexpr int kMostDoublings = 2;
/// The fit doubles gamma if the support then covers more left-out states per volume. Volumes are
/// compared at kCoarseSteps time steps, with a fraction kLeftOutside of left-out states outside.
inline constexpr int kCoarseSteps = 12;
inline constexpr double kLeftOutside = 0.1;
/// Required fraction of left-out states inside. With a smaller fraction, the fit doubles the range
/// of time steps that an estimate pools, at most kMostWidenings times.
inline constexpr double kWantedInside = 0.85;
inline constexpr int kMostWidenings = 2;
/// GuardSettings::max_actions of a fit, relative to the horizon.
inline constexpr int kActionsPerStep = 12;
/// Default action limit relative to the largest demonstrated value.
inline constexpr double kActionReach = 1.5;

/// ActionSpace: an entry with few values is a velocity or an increment if a regression on it
/// explains kLeastMoved of the squared changes of a state entry, and kProportional of the changes
/// that the action's other entries leave unexplained. A new value must have the same effect in its
/// first step as in later steps, within a factor kSameEffect.
inline constexpr double kLeastMoved = 0.01;
inline constexpr double kProportional = 0.7;
inline constexpr double kSameEffect = 2.0;
/// A feature counts as moved only by unsteered entries of an action if two conditions hold.
/// Unsteered entries explain more than kPassedExplain of the change that steered entries leave
/// unexplained. Adding steered entries to unsteered ones explains at most kSteeredExplain more.
inline constexpr double kPassedExplain = 0.3;
inline constexpr double kSteeredExplain = 0.2;
/// Features moved only by unsteered entries of an action are the context of NominalControl(). A
/// difference of this fraction of a demonstrated range multiplies the weight of a demonstrated
/// transition by exp(-1).
inline constexpr double kContextUnit = 0.25;

/// Choice of features: fraction of the variance that may remain unexplained by the chosen entries.
inline constexpr double kLeftVariance = 0.01;
/// Below this fraction of left-out states inside, the fit is refused: a guard would halt almost
/// every policy.
inline constexpr double kLeastInside = 0.2;

/// Requirements on a guard with components: the smallest fraction of left-out states inside, and
/// the largest GuardSummary::below_pass. For pictures that need 20 components, guards
/// with 3 and 6 components reduced a policy's completions from 97.5 % to 50 % and 75 %.
inline constexpr double kLeastInsideReduced = 0.85;
inline constexpr double kMostBelowPassReduced = 0.2;
/// Number of features up to which a fit keeps gamma. The squared distance between demonstrations
/// grows with the number of whitened features, so gamma decreases beyond this number.
inline constexpr double kFeaturesOfGamma = 3.0;
/// Largest number of components chosen by actions. A fit compares directions in the space of this
/// number of leading components, which overfit less, with directions in the space of all
/// components.
inline constexpr int kMostByActions = 12;
/// Largest fraction of left-out actions that may be predicted to end outside. Above it the guard
/// only monitors, because its corrections would be harmful. In 41 fits this fraction was 4 to 10 %
/// (feature points, no harm) or 14 to 47 % (components of pixels, mostly harmful).
inline constexpr double kMostOutsideReduced = 0.12;
/// If features explain less than this fraction of the actions, and the squared error of the entry
/// that varies most exceeds 1 - kLeastTold of its squares, corrections are guesses: the guard only
/// monitors.
inline constexpr double kLeastTold = 0.4;
/// Explained fraction of noise-free actions below which a guard prevents few failures.
inline constexpr double kLeastExplainedReduced = 0.8;

/// Thresholds of warnings: number of demonstrations, share of left-out states inside, shares of the
/// demonstrator's actions that are changed or end outside, level of the alarm, largest and smallest
/// action limit relative to the largest demonstrated value, and chance of a drift of at least
/// kLeastDrift. kLeastReach is below 1, because drivers of robots often clip the largest actions
/// slightly.
inline constexpr int kFewestDemonstrations = 10;
inline constexpr double kLeastAcceptance = 0.7;
inline constexpr double kMostChanged = 0.3;
inline constexpr double kMostOutside = 0.3;
inline constexpr double kLowestAlarm = 3.0;
inline constexpr double kMostOvershoot = 5.0;
inline constexpr double kLeastReach = 0.9;
inline constexpr double kUnlikely = 0.01;
inline constexpr double kLeastDrift = 0.2;
/// Smallest fraction of the features' changes that the response must explain. With a smaller
/// fraction, corrections are unreliable.
inline constexpr double kLeastResponse = 0.5;
/// An action of another step counts as the cause of a feature's change if it explains more of the
/// change than the recorded action does. The difference must be at least this fraction of the part
/// that the state does not determine.
inline constexpr double kLagGain = 0.3;
/// Maximum squared deviation from uniform motion of an entry that advances like a clock, as a
/// fraction of its variance.
inline constexpr double kClockError = 1e-3;

/// If an entry that has the value c in all demonstrations differs from c by more than
/// kConstantTolerance max(1, |c|), the state belongs to another task.
inline constexpr double kConstantTolerance = 1e-3;

/// A sensor is frozen if its entries are identical for more than kStandstillFactor times the
/// longest demonstrated standstill plus kStandstillMargin steps.
inline constexpr double kStandstillFactor = 2.0;
inline constexpr double kStandstillMargin = 3.0;

}  // namespace dfr::safety::fit
