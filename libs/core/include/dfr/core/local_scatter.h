#pragma once

#include <span>

#include "dfr/core/matrix.h"

namespace dfr::core {

/// Options for LocalScatter().
struct LocalScatterOptions {
  /// Each point is compared with this share of the others, the nearest ones; in (0, 1).
  double neighbours = 0.125;
  /// Share of the points of each group that count, those whose neighbours are nearest, in (0, 1].
  /// Points between the ways of a task, and outliers, have theirs far away.
  double kept = 0.5;
  int rounds = 3;  ///< > 0; distances of a round are in units of the scatter of the one before.
  double ridge = 0.03;  ///< For those units, relative to a correlation; > 0.
};

/// The covariance that points have about their neighbours: with several clusters that of one, where
/// the sample covariance measures the distance between them. Mean of (x_i - x_j)(x_i - x_j)' / 2
/// over points i and their nearest neighbours j in the same group, divided by the value of the same
/// statistic for as many standard normal points, so that normal points nearly keep their covariance
/// (neighbours are chosen in units of it; clusters of half of the points come out as up to three
/// times as wide as they are). Each entry counts at least a twentieth of its standard
/// deviation in all.
///
/// @param groups  points that are alike, one a row, e.g. those of one time step; those with fewer
///   than 4 points are left out. Of more than 128 points of a group as many are looked at.
/// @returns n x n; PooledCovariance() if no group has 4 points.
/// @throws std::invalid_argument if there is no point, widths differ, or an option is out of range.
[[nodiscard]] Matrix LocalScatter(std::span<const Matrix> groups,
                                  const LocalScatterOptions& options = {});

/// The covariance of the points about the means of their groups, pooled over groups.
/// @throws std::invalid_argument if there is no point or widths differ.
[[nodiscard]] Matrix PooledCovariance(std::span<const Matrix> groups);

/// (covariance + ridge I)^(-1/2), symmetric. @throws std::invalid_argument unless ridge > 0.
[[nodiscard]] Matrix InverseSquareRoot(const Matrix& covariance, double ridge);

}  // namespace dfr::core
