#include "platform_error.h"

#include <cmath>
#include <cstddef>
#include <numbers>

#include "dfr/core/random.h"

namespace dfr::sim::internal {

PlatformError::PlatformError(std::uint64_t seed) {
  constexpr std::array<double, 3> kRms = {1.22e-3, 1.07e-3, 0.20e-3};
  core::Random random(seed);
  for (std::size_t k = 0; k < 3; ++k) {
    for (Term& term : terms[k]) {
      // Two sines of random phase, each with half of the mean square.
      term.amplitude = kRms[k];
      for (int i = 0; i < 6; ++i) term.rate[i] = (i < 3 ? 150.0 : 15.0) * random.Normal();
      term.phase = random.Uniform(0.0, 2.0 * std::numbers::pi);
    }
  }
}

Eigen::Vector3d PlatformError::At(const kinematics::PlatformPose& pose) const noexcept {
  Eigen::Matrix<double, 6, 1> p;
  p << pose.translation_m, pose.angles_rad;
  Eigen::Vector3d error = Eigen::Vector3d::Zero();
  for (int k = 0; k < 3; ++k) {
    for (const Term& term : terms[static_cast<std::size_t>(k)]) {
      error[k] += term.amplitude * std::sin(term.rate.dot(p) + term.phase);
    }
  }
  return error;
}

}  // namespace dfr::sim::internal
