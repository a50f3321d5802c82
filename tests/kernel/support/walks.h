#pragma once

#include <cstdint>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/random.h"

namespace dfr::test {

/// Returns walks of 8 to 12 steps to the right. Each starts near the origin, and `aside` is the
/// standard deviation of the sideways part of a step.
inline std::vector<core::Matrix> Walks(int count, std::uint64_t seed, double aside = 0.1) {
  core::Random random(seed);
  std::vector<core::Matrix> walks;
  for (int d = 0; d < count; ++d) {
    core::Matrix states(9 + static_cast<int>(random.Below(5)), 2);
    states.row(0) << 0.1 * random.Normal(), 0.1 * random.Normal();
    for (Eigen::Index t = 1; t < states.rows(); ++t) {
      states.row(t) = states.row(t - 1);
      states(t, 0) += 1.0 + 0.1 * random.Normal();
      states(t, 1) += aside * random.Normal();
    }
    walks.push_back(states);
  }
  return walks;
}

}  // namespace dfr::test
