#pragma once

/// What decides how guided recovery behaves and is no option. docs/frozen_constants.md lists all of
/// it.
namespace dfr::control::guided {

/// Response: the share of what controls leave unexplained, in demonstrations that an estimate
/// has not seen, that a drift may leave at most. Less would be noise that is explained: free
/// motion and contact are better off without.
inline constexpr double kMostLeft = 0.6;
/// The quantile of -l over states of unseen demonstrations that is their slack.
inline constexpr double kSlackQuantile = 0.2;

/// TransitionStore: added to each weight, so that where all transitions are far from z none of them
/// counts more than the others.
inline constexpr double kWeightFloor = 1e-6;

/// ResponseEstimate::NominalControl(): for the slopes, per unit of weight. Where states hardly
/// differ in a direction, the control does not depend on it.
inline constexpr double kDemonstratedRidge = 0.1;
/// The price of a control that differs from the one demonstrations took, in units of what a control
/// does to the features.
inline constexpr double kNearness = 0.03;
/// ResponseEstimate::LeastExcitedDirection(): rounds of power iteration. A^-1 is a few rows wide,
/// and a direction that is nearly the least known is as good as the least known.
inline constexpr int kPowerIterations = 30;

/// StateObserver: the least weight of what is seen. Below it the estimate would hardly look any
/// more.
inline constexpr double kLeastWeight = 0.2;
/// Predictions of a lag have to be so much better, in squared error, than those of a smaller one.
inline constexpr double kEvidence = 2.0;
/// Squared errors below this share of the squared changes, a hundredth each, are rounding and the
/// ridge: no reason to find a lag or noise.
inline constexpr double kNegligible = 1e-4;

/// AscendSupport(): less than this changes nothing that is decided by a level.
inline constexpr double kLeastGain = 1e-3;

/// GuidedController, with least intervention: a step that passes at the edge counts, and a count is
/// forgotten by this factor a step.
inline constexpr double kEdgeMemory = 0.98;
/// So many counts are free. Beyond them the level at which the learned control passes rises to the
/// gate level, over this many counts. A policy that stays at the edge for long would otherwise fail
/// wherever the support reaches too far.
inline constexpr double kEdgeGrace = 10.0;
inline constexpr double kEdgeRamp = 10.0;

/// SafetyFilter: where no control is predicted to end inside, a change of the learned control of
/// this length at most, in ordinary controls, is not made if it gains little.
inline constexpr double kIdle = 0.5;
/// SafetyFilter: largest eigenvalue of A^-1 beyond which a direction of control counts as unknown,
/// a fifth of an ordinary control's measurement.
inline constexpr double kUnknown = 5.0;
/// A support from so few demonstrations that others are further outside than this does not know the
/// task, whatever their slack.
inline constexpr double kMaxExitLevel = 0.8;

}  // namespace dfr::control::guided
