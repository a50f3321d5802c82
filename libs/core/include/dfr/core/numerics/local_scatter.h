#pragma once

#include <span>

#include "dfr/core/matrix.h"

namespace dfr::core {

/// Options for LocalScatter().
struct LocalScatterOptions {
  /// Fraction of the other points that count as neighbours of a point, nearest first, in (0, 1).
  double neighbours = 0.125;
  /// Fraction of each group's points that count, in (0, 1]: those with the nearest neighbours.
  /// Outliers and points between two ways to do a task have distant neighbours.
  double kept = 0.5;
  /// Number of rounds, > 0. Each round measures distances in units of the previous round's scatter.
  int rounds = 3;
  double ridge = 0.03;  ///< Added to the diagonal of each round's correlation matrix, > 0.
};

/// Covariance of points about their neighbours. For data with several clusters it is the covariance
/// within a cluster, whereas the sample covariance measures the distance between clusters.
///
/// It is the mean of (x_i - x_j)(x_i - x_j)' / 2 over points i and their nearest neighbours j in
/// the same group, divided by the same statistic of as many standard normal points. Normally
/// distributed points therefore nearly keep their covariance. If each of two clusters has half of
/// the points, the result is up to three times their actual width. The standard deviation of each
/// entry is at least a twentieth of its value in PooledCovariance().
///
/// @param groups  similar points, one per row, for example those of one time step. Groups with
/// fewer than 4 points are ignored. At most 128 points of a group are used.
/// @returns n x n; PooledCovariance() if no group has 4 points.
/// @throws std::invalid_argument if there is no point, widths differ, or an option is out of range.
[[nodiscard]] Matrix LocalScatter(std::span<const Matrix> groups,
                                  const LocalScatterOptions& options = {});

/// Returns the covariance of the points about their group means, pooled over groups; exactly 0 for
/// an entry that is constant within each group.
/// @throws std::invalid_argument if there is no point or widths differ.
[[nodiscard]] Matrix PooledCovariance(std::span<const Matrix> groups);

/// Returns (covariance + ridge I)^(-1/2), symmetric.
/// @throws std::invalid_argument unless ridge > 0.
[[nodiscard]] Matrix InverseSquareRoot(const Matrix& covariance, double ridge);

}  // namespace dfr::core
