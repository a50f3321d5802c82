#pragma once

#include <cstdint>

#include "dfr/core/matrix.h"

namespace dfr::bench {

/// Returns `n` states of `d` entries from robot-like trajectories of 100 steps: a common smooth
/// path with a different pace and offset for each trajectory, plus small noise; standardised to
/// mean 0 and variance 1.
[[nodiscard]] core::Matrix PooledTrajectories(int n, int d, std::uint64_t seed);

/// Overload for a task that drifts: from the first to the last trajectory the common path moves by
/// about the spread of all trajectories, and each trajectory has a separate offset in every entry.
/// With many entries and a narrow kernel, samples are nearly isolated.
[[nodiscard]] core::Matrix DriftingTrajectories(int n, int d, std::uint64_t seed);

}  // namespace dfr::bench
