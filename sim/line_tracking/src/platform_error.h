#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>

#include "dfr/kinematics/sprk_platform.h"

namespace dfr::sim::internal {

/// Positioning error of an individual platform: waves over its workspace with the published RMS.
struct PlatformError {
  struct Term {
    double amplitude = 0.0;
    Eigen::Matrix<double, 6, 1> rate = Eigen::Matrix<double, 6, 1>::Zero();  ///< per m, per rad
    double phase = 0.0;
  };
  std::array<std::array<Term, 2>, 3> terms;

  explicit PlatformError(std::uint64_t seed);

  [[nodiscard]] Eigen::Vector3d At(const kinematics::PlatformPose& pose) const noexcept;
};

}  // namespace dfr::sim::internal
