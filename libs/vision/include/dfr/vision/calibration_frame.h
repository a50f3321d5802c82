#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

namespace dfr::vision {

/// One sample of a calibration motion, taken at rest.
struct CalibrationFrame {
  std::array<double, 6> joints{};  ///< Reported by the arm, in the order of `measured_js`.
  Eigen::Vector2d tip_px = Eigen::Vector2d::Zero();  ///< NaN if not seen.
  bool touching = false;                             ///< The tip touches the target's plane.
  std::vector<Eigen::Vector2d> marks_px;             ///< In the target's order; NaN if not seen.
};

}  // namespace dfr::vision
