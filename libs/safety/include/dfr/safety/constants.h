#pragma once

#include <cstddef>

/// Constants of the fit of a guard that are not options. docs/frozen_constants.md lists them.
namespace dfr::safety::fit {

/// Number of folds that leave demonstrations out.
inline constexpr int kFolds = 5;
/// Fraction of points, or of time steps if that is more, that a mode separation test may find
/// inside, and the maximum number of doublings of gamma.
inline constexpr double kMostInGaps = 0.05;
inline constexpr int kMostDoublings = 2;
/// The fit doubles gamma if that reduces the logarithm of the support's volume by at least
/// kLeastGain plus the share of left-out states that it loses. Volumes are compared at kCoarseSteps
/// time steps, with kLeftOutside of the left-out states outside.
inline constexpr double kLeastGain = 0.15;
inline constexpr int kCoarseSteps = 12;
inline constexpr double kLeftOutside = 0.1;
/// Required fraction of left-out states inside. Below it a support pools more time steps, at most
/// kMostWidenings times.
inline constexpr double kWantedInside = 0.85;
inline constexpr int kMostWidenings = 2;
/// Maximum number of actions per action of the policy.
inline constexpr int kActionsPerStep = 12;
/// Default action limit relative to the largest demonstrated value.
inline constexpr double kActionReach = 1.5;

/// ActionSpace: an entry with few values is a velocity or an increment if a regression on it
/// explains kLeastMoved of an entry of the state's squared changes, and kProportional of those that
/// the action's other entries leave. The effect of a new value in its first step must be the same,
/// within a factor kSameEffect.
inline constexpr double kLeastMoved = 0.01;
inline constexpr double kProportional = 0.7;
inline constexpr double kSameEffect = 2.0;
/// Only entries of the action that the guard does not steer move a feature if the steered ones
/// explain at most kSteeredExplain of its change in addition to the others, and the others more
/// than kPassedExplain of what the steered ones leave.
inline constexpr double kPassedExplain = 0.3;
inline constexpr double kSteeredExplain = 0.2;
/// Features that only passed entries of an action move tell which demonstrations were in the same
/// situation: a difference of this share of their demonstrated range reduces a weight to exp(-1).
inline constexpr double kContextUnit = 0.25;

/// Choice of features: fraction of the variance that may remain unexplained by the chosen entries.
inline constexpr double kLeftVariance = 0.01;
/// Below this fraction of left-out states inside, the fit is refused: a guard would halt almost
/// every policy.
inline constexpr double kLeastInside = 0.2;

/// Requirements on a guard on components for held-out demonstrations: their states are inside, and
/// their actions pass. On pictures that need 20 components, guards on 3 and 6 reduced the
/// completions of a policy from 97.5 to 50 and 75 %.
inline constexpr double kLeastInsideReduced = 0.85;
inline constexpr double kMostChangedReduced = 0.2;
/// gamma suits a few features. The squared distance between two demonstrations grows with the
/// number of whitened features, so gamma decreases with it.
inline constexpr double kFeaturesOfGamma = 3.0;
/// Corrections do harm where the demonstrator's own actions are predicted to end outside: above
/// this share of left-out actions the guard only watches. The guards of 41 fits had 4 to 10 %
/// (feature points, no harm) or 14 to 47 % (components of pixels, most of them with harm).
inline constexpr double kMostOutsideReduced = 0.12;
/// Features that explain less of the actions than this, and miss more than 1 - kLeastTold of the
/// squares of the entry that varies most, make corrections guesses: the guard only watches.
inline constexpr double kLeastTold = 0.4;
/// Features that explain less of the actions save few failures, unless actions carry noise.
inline constexpr double kLeastExplainedReduced = 0.8;

/// Thresholds of warnings: number of demonstrations, share of left-out states inside, shares of the
/// demonstrator's own actions that are changed or end outside, level of the alarm, largest and
/// smallest action limit relative to the largest demonstrated value, and chance of a drift of at
/// least kLeastDrift. Drivers often clip the largest actions slightly.
inline constexpr int kFewestDemonstrations = 10;
inline constexpr double kLeastAcceptance = 0.7;
inline constexpr double kMostChanged = 0.3;
inline constexpr double kMostOutside = 0.3;
inline constexpr double kLowestAlarm = 3.0;
inline constexpr double kMostOvershoot = 5.0;
inline constexpr double kLeastReach = 0.9;
inline constexpr double kUnlikely = 0.01;
inline constexpr double kLeastDrift = 0.2;
/// Share of the features' changes that the response explains. Below it corrections are unreliable.
inline constexpr double kLeastResponse = 0.5;
/// An earlier or later action moves a feature if it explains at least this share more of the change
/// that the state leaves open than the recorded one does.
inline constexpr double kLagGain = 0.3;
/// Share of its variance that an entry which advances like a clock may deviate from uniform motion.
inline constexpr double kClockError = 1e-3;

/// An entry that was constant in all demonstrations differs from its value by more than this
/// fraction of it, or of 1: the state is of another task.
inline constexpr double kConstantTolerance = 1e-3;

/// A sensor is frozen if its entries are the same to the bit for more than kStandstillFactor times
/// the longest demonstrated standstill and kStandstillMargin more steps.
inline constexpr double kStandstillFactor = 2.0;
inline constexpr double kStandstillMargin = 3.0;

}  // namespace dfr::safety::fit
