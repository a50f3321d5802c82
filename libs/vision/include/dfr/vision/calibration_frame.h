#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

namespace dfr::vision {

/// One moment of the motion that a calibration records, everything at rest.
struct CalibrationFrame {
  std::array<double, 6> joints{};  ///< What the arm reports, in the order of `measured_js`.
  Eigen::Vector2d tip_px = Eigen::Vector2d::Zero();  ///< NaN where it was not seen.
  bool touching = false;                             ///< The tip touches the target's plane.
  std::vector<Eigen::Vector2d> marks_px;             ///< In the target's order, NaN where not seen.
};

}  // namespace dfr::vision
