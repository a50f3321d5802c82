#pragma once

#include <cstdint>

#include "dfr/core/matrix.h"

namespace dfr::bench {

/// `n` states of `d` entries pooled from robot-like trajectories of 100 steps (slow sums of sines
/// around a common path, with its own offset and pace each), standardised to mean 0 and variance 1.
[[nodiscard]] core::Matrix PooledTrajectories(int n, int d, std::uint64_t seed);

}  // namespace dfr::bench
