#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

namespace dfr::vision {

/// One sample of a calibration motion, taken at rest.
struct CalibrationFrame {
  std::array<double, 6> joints{};  ///< Joint readings in the order of `measured_js`.
  Eigen::Vector2d tip_px = Eigen::Vector2d::Zero();  ///< NaN if not seen.
  /// True if the tip touches the target's plane.
  bool touching = false;
  std::vector<Eigen::Vector2d> marks_px;  ///< In the target's order; NaN if not seen.
};

}  // namespace dfr::vision
