#pragma once

#include <cstddef>

/// Constants of guided recovery that are not options. docs/frozen_constants.md lists them.
namespace dfr::control::guided {

/// Response has a drift only if the drift leaves at most this fraction of the variance that
/// controls alone leave unexplained in held-out demonstrations. With a larger value the drift would
/// fit noise in free motion and contact.
inline constexpr double kMostLeft = 0.6;
/// Response: demonstrated changes of features are too noisy for LocalFit::NominalControl() if its
/// squared error for held-out controls exceeds this multiple of the squared error of
/// DemonstratedControl(). In 54 fits without sensor noise the ratio was at most 1.15. With noise of
/// .2, .4, .7 and 1 % of the path length it was 1.05, 2.1, 4.7 and 8.9.
inline constexpr double kMostWorse = 1.25;
/// EstimateSlack(): the slack is minus this quantile of l over held-out demonstrated states.
inline constexpr double kSlackQuantile = 0.2;

/// FewValues: an entry of a control has few values if demonstrations contain at most kMostFew
/// distinct values, each kLeastRepeated times on average.
inline constexpr std::size_t kMostFew = 4;
inline constexpr std::size_t kLeastRepeated = 5;
/// SafetyFilter: entries with many values must contain at least this fraction of the squared length
/// of a probe's direction.
inline constexpr double kLeastProbe = 0.5;

/// TransitionStore: added to each weight, in units of the weight of the nearest transition. It
/// keeps the sum of the weights positive.
inline constexpr double kWeightFloor = 1e-6;

/// ResponseEstimate: limit on the mean of the smaller of two consecutive squared errors, in units
/// of the mean squared demonstrated change. Up to this limit, a different response may cause the
/// errors: an ordinary control with 1.7 times its demonstrated effect has the error .5. Above it,
/// the cause is sensor noise, and the ridge of J grows by kNoiseRidge times the excess. A single
/// push or jump causes one large error and does not count.
inline constexpr double kMostError = 0.5;
inline constexpr double kNoiseRidge = 6.0;

/// LocalFit::NominalControl(): ridge of the slopes per unit of weight. The control then does not
/// depend on directions in which states barely differ.
inline constexpr double kDemonstratedRidge = 0.1;
/// LocalFit::NominalControl(): penalty on the squared difference from the demonstrated control, in
/// units of trace(J' J) / m, the mean squared effect of a unit control.
inline constexpr double kNearness = 0.03;
/// LocalFit::LeastExcitedDirection(): number of power iterations. A^-1 has few rows, and an
/// approximate eigenvector suffices.
inline constexpr int kPowerIterations = 30;

/// StateObserver: smallest weight of an observation. With a smaller weight the estimate would
/// ignore observations.
inline constexpr double kLeastWeight = 0.2;
/// StateObserver: rejects a lag whose squared error exceeds this multiple of the smallest error of
/// all lags.
inline constexpr double kEvidence = 2.0;
/// Squared errors below this fraction of the squared changes (errors below 1 % of the changes) are
/// attributed to rounding and the ridge, not to a lag or noise.
inline constexpr double kNegligible = 1e-4;

/// AscendSupport(): gain of l below which the ascent ends. A smaller gain changes no decision.
inline constexpr double kLeastGain = 1e-3;

/// EdgeStay: forgetting factor per step on the number of earlier steps at the edge.
inline constexpr double kEdgeMemory = 0.98;
/// Fraction of held-out demonstrations that stay at the edge no longer than Levels::edge_stay().
/// After a longer stay, the level at which the learned control passes rises to the gate level over
/// kEdgeRamp steps. Otherwise a policy that stays at the edge would fail where the support is too
/// wide.
inline constexpr double kEdgeStayQuantile = 0.9;
/// Smallest Levels::edge_stay(). Few or short demonstrations would give too small a value.
inline constexpr double kLeastEdgeStay = 10.0;
inline constexpr double kEdgeRamp = 10.0;
/// Levels::pass_depth(): minus this quantile of l over held-out demonstrated states.
inline constexpr double kPassDepthQuantile = 0.05;
/// Levels::prediction_error(): this quantile of the error of l at predicted states.
inline constexpr double kPredictionQuantile = 0.95;
/// SafetyFilter: at the pass depth a control passes unless a correction is predicted to end inside.
/// It always passes at a level that the error of predictions explains, down to this multiple of the
/// exit level, or if its norm is at most kResting ordinary controls: a correction would push a
/// policy that waits.
inline constexpr double kShallowDepth = 0.25;
inline constexpr double kResting = 0.2;
/// GuidedController: after this number of consecutive corrections no control passes at the pass
/// depth until a control passes without it. A policy that leaves the support does so repeatedly.
inline constexpr int kDepthCorrections = 2;
/// GuidedController: halts after kMostAway consecutive controls that lead away. A control leads
/// away if the distance to the nearest demonstrated state grows by more than this fraction of the
/// change of the state: a motion within 60 degrees of the direction directly away.
inline constexpr double kLeadsAway = 0.5;
inline constexpr int kMostAway = 4;
/// GuidedController: maximum number of relocations of the phase in an episode.
inline constexpr int kMostRelocations = 2;

/// SafetyFilter: a change of the learned control is skipped if its norm is at most this multiple of
/// an ordinary control, it gains little, and the changed control would still not pass. kIdleAtRest
/// applies instead if the world rests and the learned control does not lower the level: waiting
/// then costs nothing. The world rests if no model of a disturbance is active and the drift of the
/// features is at most kRestDrift times the root mean square effect of an ordinary control.
inline constexpr double kIdle = 0.5;
inline constexpr double kIdleAtRest = 1.5;
inline constexpr double kRestDrift = 0.3;
/// SafetyFilter: beyond the exit level, and after the last support, a raised control replaces the
/// demonstrated one only if its predicted l, which is negative, exceeds this fraction of the
/// demonstrated control's l.
inline constexpr double kWorthRaising = 0.5;
/// SafetyFilter: if an ascent changes an entry by more than this multiple of an ordinary control,
/// LocalFit::Agreement() damps the change. Agreement() uses every kAgreementStride-th transition.
inline constexpr double kLeastHedged = 0.4;
inline constexpr int kAgreementStride = 8;
/// SafetyFilter: in a state no farther outside than held-out demonstrations, an ascent moves no
/// entry beyond this multiple of the root mean square of its demonstrated values nearby. In
/// contact, for example, demonstrations move less than elsewhere, and J is a mean over both.
inline constexpr double kLocalReach = 3.0;
/// SafetyFilter: in a world that moves by itself, an ascent that ends outside reverses no entry in
/// which the learned and the demonstrated control agree in sign, and both exceed this multiple of
/// an ordinary control. A later control could not undo such a reversal.
inline constexpr double kClearSign = 0.1;
/// SafetyFilter: a direction of control counts as unknown if the largest eigenvalue of A^-1 exceeds
/// this value. Measurements in this direction then weigh less than a fifth of an ordinary control.
inline constexpr double kUnknown = 5.0;
/// Upper limit of the exit level. If held-out states are farther outside, there are too few
/// demonstrations for the support.
inline constexpr double kMaxExitLevel = 0.8;

}  // namespace dfr::control::guided
