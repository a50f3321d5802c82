#pragma once

/// What decides how guided recovery behaves and is no option: docs/frozen_constants.md lists it.
namespace dfr::control::guided {

/// Largest eigenvalue of A^-1 (JacobianEstimate) beyond which a direction of control counts as
/// unknown: a fifth of an ordinary control's measurement.
inline constexpr double kUnknown = 5.0;
/// A support from so few demonstrations that others are further outside than this does not know
/// the task, whatever their slack.
inline constexpr double kMostReach = 0.8;

}  // namespace dfr::control::guided
