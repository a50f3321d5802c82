#include "bench/kernel/trajectories.h"

#include <array>
#include <cmath>

#include "dfr/core/random.h"

namespace dfr::bench {
namespace {

void Standardise(core::Matrix& states) {
  for (Eigen::Index k = 0; k < states.cols(); ++k) {
    const double mean = states.col(k).mean();
    states.col(k).array() -= mean;
    states.col(k) /= std::sqrt(states.col(k).squaredNorm() / static_cast<double>(states.rows()));
  }
}

}  // namespace

core::Matrix PooledTrajectories(int n, int d, std::uint64_t seed) {
  constexpr int kSteps = 100;
  constexpr int kTraits = 2;  // trajectories differ in start or goal, and pace
  constexpr double kSpread = 0.3;
  constexpr double kNoise = 0.05;
  core::Random common(core::DeriveSeed(seed, {0}));
  core::Matrix path(d, 3), response(d, kTraits);
  for (int k = 0; k < d; ++k) {
    path.row(k) << common.Uniform(0.5, 1.5), common.Uniform(0.0, 6.0), common.Normal();
    for (int j = 0; j < kTraits; ++j) response(k, j) = common.Normal();
  }
  core::Random random(core::DeriveSeed(seed, {1}));
  core::Matrix states(n, d);
  std::array<double, kTraits> traits{};
  for (int i = 0; i < n; ++i) {
    if (i % kSteps == 0) {
      for (double& trait : traits) trait = kSpread * random.Normal();
    }
    const double t = (1.0 + 0.5 * traits[0]) * (i % kSteps) / kSteps;
    for (int k = 0; k < d; ++k) {
      states(i, k) =
          std::sin(6.28 * path(k, 0) * t + path(k, 1)) + path(k, 2) * t + kNoise * random.Normal();
      for (std::size_t j = 0; j < kTraits; ++j) {
        states(i, k) += response(k, static_cast<Eigen::Index>(j)) * traits[j];
      }
    }
  }
  Standardise(states);
  return states;
}

core::Matrix DriftingTrajectories(int n, int d, std::uint64_t seed) {
  constexpr int kSteps = 100;
  constexpr double kSpread = 0.3;
  constexpr double kNoise = 0.05;
  core::Random random(seed);
  core::Matrix path(d, 4);
  for (int k = 0; k < d; ++k) {
    path.row(k) << random.Uniform(0.5, 1.5), random.Uniform(0.0, 6.28), random.Normal(),
        random.Normal();
  }
  core::Matrix states(n, d);
  Eigen::VectorXd offset(d);
  for (int i = 0; i < n; ++i) {
    if (i % kSteps == 0) {
      for (int k = 0; k < d; ++k) offset[k] = kSpread * random.Normal();
    }
    const double t = static_cast<double>(i % kSteps) / kSteps;
    const double drift = static_cast<double>(i) / n;
    for (int k = 0; k < d; ++k) {
      states(i, k) = std::sin(6.28 * path(k, 0) * t + path(k, 1)) + 0.5 * path(k, 2) * t +
                     path(k, 3) * drift + offset[k] + kNoise * random.Normal();
    }
  }
  Standardise(states);
  return states;
}

}  // namespace dfr::bench
