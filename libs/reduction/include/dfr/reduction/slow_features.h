#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/core/matrix.h"

namespace dfr::reduction {

/// Slow features of episodes: directions along which rows x - mean change little from step to step,
/// compared with their variance over all episodes.
struct SlowFeatures {
  Eigen::VectorXd mean;  ///< d
  /// k x d. Along each direction, the differences of successive rows of an episode have variance 1.
  /// Slowest first. The largest entry of each row is positive.
  core::Matrix directions;
  /// k; v' Cov(x) v / v' Cov(x_(t+1) - x_t) v, descending. White noise has 1/2.
  Eigen::VectorXd slowness;
};

/// Fits slow features (Wiskott and Sejnowski, Neural Computation 14(4), 2002): the directions v
/// that maximise v' Cov(x) v / v' D v, where D is the covariance of differences within episodes.
/// Smooth motion and values constant within an episode are slow; noise is not.
///
/// The fit adds 1e-6 of the entries' mean variance to the diagonal of D, which bounds directions
/// without differences. It drops directions in which rows do not vary.
/// @param episodes  rows in time order, d columns each.
/// @throws std::invalid_argument if widths differ, there is no difference, an entry is not finite,
///   or all rows are equal.
[[nodiscard]] SlowFeatures FitSlowFeatures(std::span<const core::Matrix> episodes);

}  // namespace dfr::reduction
