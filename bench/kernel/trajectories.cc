#include "bench/kernel/trajectories.h"

#include <cmath>
#include <vector>

#include "dfr/core/random.h"

namespace dfr::bench {

core::Matrix PooledTrajectories(int n, int d, std::uint64_t seed) {
  constexpr int kSteps = 100;
  core::Random common(core::DeriveSeed(seed, {0}));
  std::vector<double> frequency, phase, slope;
  for (int k = 0; k < d; ++k) {
    frequency.push_back(common.Uniform(0.5, 1.5));
    phase.push_back(common.Uniform(0.0, 6.0));
    slope.push_back(common.Normal());
  }
  core::Random random(core::DeriveSeed(seed, {1}));
  core::Matrix states(n, d);
  std::vector<double> offset(static_cast<std::size_t>(d)), swing(static_cast<std::size_t>(d));
  double pace = 1.0;
  for (int i = 0; i < n; ++i) {
    if (i % kSteps == 0) {
      pace = random.Uniform(0.8, 1.2);
      for (double& o : offset) o = 0.25 * random.Normal();
      for (double& s : swing) s = 1.0 + 0.2 * random.Normal();
    }
    const double t = pace * (i % kSteps) / kSteps;
    for (int k = 0; k < d; ++k) {
      const auto c = static_cast<std::size_t>(k);
      states(i, k) = swing[c] * std::sin(6.28 * frequency[c] * t + phase[c]) + slope[c] * t +
                     offset[c] + 0.05 * random.Normal();
    }
  }
  for (int k = 0; k < d; ++k) {
    const double mean = states.col(k).mean();
    states.col(k).array() -= mean;
    states.col(k) /= std::sqrt(states.col(k).squaredNorm() / n);
  }
  return states;
}

}  // namespace dfr::bench
