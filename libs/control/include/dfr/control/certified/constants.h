#pragma once

/// What decides how certified recovery behaves and is no option: docs/frozen_constants.md lists it.
namespace dfr::control::certified {

/// A learned control that is raised and still predicted further outside than this multiple of
/// Levels::slack() counts as a recovery.
inline constexpr double kMaxExitRatio = 2.0;
/// Times that a control is raised until it passes.
inline constexpr int kRounds = 3;
/// Its need is met a little later than it is computed: the slope of l differs where it leads to.
inline constexpr double kOvershoot = 0.02;
/// The smallest part of a control that is tried about the state that it leads to; then the ball
/// about the present one says which part passes.
inline constexpr double kLeastPart = 0.25;
/// A control of which less than this share passes is a stall ...
inline constexpr double kLeastShare = 0.02;
/// ... and so many in a row end the episode.
inline constexpr int kMaxStalls = 3;

}  // namespace dfr::control::certified
