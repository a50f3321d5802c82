#pragma once

/// Constants of certified recovery that are not options. docs/frozen_constants.md lists them.
namespace dfr::control::certified {

/// A corrected learned control counts as a recovery if it is predicted to end outside by more than
/// this multiple of Levels::slack().
inline constexpr double kMaxExitRatio = 2.0;
/// Maximum number of ascents until a control passes.
inline constexpr int kRounds = 3;
/// Margin of an ascent above the required level, which changes with the slope of l.
inline constexpr double kOvershoot = 0.02;
/// Smallest fraction of a control that is checked at its predicted state. The ball at the present
/// state determines smaller fractions.
inline constexpr double kLeastPart = 0.25;
/// A recovery replaces a control of which less than this fraction passes. A recovery of which less
/// passes is a stall.
inline constexpr double kLeastShare = 0.02;
/// Number of consecutive stalls that end the episode.
inline constexpr int kMaxStalls = 3;

}  // namespace dfr::control::certified
