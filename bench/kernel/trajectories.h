#pragma once

#include <cstdint>

#include "dfr/core/matrix.h"

namespace dfr::bench {

/// `n` states of `d` entries pooled from robot-like trajectories of 100 steps: a common smooth path
/// that each follows at its own pace and with its own offset, and a little noise; standardised to
/// mean 0 and variance 1.
[[nodiscard]] core::Matrix PooledTrajectories(int n, int d, std::uint64_t seed);

/// As above, of a task that drifts: what all trajectories share moves from the first to the last by
/// about their whole spread, and each has an offset of its own in every entry. With many entries
/// and a narrow kernel, samples are nearly isolated.
[[nodiscard]] core::Matrix DriftingTrajectories(int n, int d, std::uint64_t seed);

}  // namespace dfr::bench
