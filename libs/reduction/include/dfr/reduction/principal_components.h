#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "dfr/core/matrix.h"
#include "dfr/reduction/row_source.h"

namespace dfr::reduction {

/// Options for FitPrincipalComponents().
struct PrincipalComponentsOptions {
  /// Maximum number of components, >= 1. A fit returns fewer if the rows vary in fewer directions.
  int components = 128;
  /// Random directions beyond `components`, >= 0. More directions make the last components more
  /// accurate.
  int oversampling = 16;
  /// Number of passes that multiply by the covariance, >= 1. After q passes, the angle of component
  /// i to its estimate is about (v_l / v_i)^q, with variances v and l = components + oversampling.
  int power_iterations = 3;
  /// The scale of an entry is its standard deviation, but at least this fraction of the root mean
  /// square over all entries, in [0, 1]. This minimum limits the noise of entries that barely vary.
  /// Use 1 for pictures, whose entries share a unit, and less if units differ.
  double scale_floor = 0.3;
  std::uint64_t seed = 1;
  int threads = 0;  ///< Number of threads; 0: one per core. The result does not depend on it.
};

/// Principal components of the standardised rows a = (x - mean) / scale.
struct PrincipalComponents {
  Eigen::VectorXd mean;   ///< d
  Eigen::VectorXd scale;  ///< d; 0 for an entry that never varies, which is ignored.
  /// k x d, orthonormal rows, in order of variance. Ignored entries are 0. The largest entry of
  /// each row is positive.
  core::Matrix components;
  Eigen::VectorXd variance;  ///< k; variance of the scores.
  core::Matrix scores;       ///< n x k; components * a of each row of the source.
};

/// Fits principal components to rows that need not fit into memory.
///
/// Randomised subspace iteration (Halko, Martinsson and Tropp, SIAM Review 53(2), 2011, Alg. 4.4)
/// on the covariance A'A / n of the n x d standardised rows A: with l = components + oversampling,
///   Q_0 = orth(G), G normal d x l;  Q_i = orth(A' (A Q_(i-1)));  eig(Q_q' A' A Q_q) -> rotation.
/// It reads the rows power_iterations + 3 times. Products are in float; orthonormalisation is in
/// double. Directions whose standard deviation is below 1e-5 of the largest are therefore noise and
/// are dropped. If all directions fit, l >= d, the subspace is exact.
///
/// Memory: about 8 d (components + 2 l) + 12 n l bytes, and 50 MB for blocks of rows.
/// @throws std::invalid_argument if there are fewer than two rows, an entry is not finite (naming
/// its row and column), no entry varies, or an option is out of range.
[[nodiscard]] PrincipalComponents FitPrincipalComponents(
    const RowSource& source, const PrincipalComponentsOptions& options = {});

}  // namespace dfr::reduction
