#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/trajectory.h"

namespace dfr::reduction {

/// Directions in the space of each block's scores, most relevant to the demonstrated actions first.
///
/// A smooth regression on all scores (Gaussian kernel, ridge) gives a gradient at each sample. The
/// regression predicts the actions and, with a tenth of their weight, the progress: a guard follows
/// the progress even where actions do not depend on it. The mean outer product of the gradients
/// becomes the metric of the kernel, and the regression is repeated. The eigenvectors of the last
/// metric are the directions (recursive feature machine; Radhakrishnan et al., Science 383, 2024).
/// The first metric is the inverse covariance of the differences of successive scores
/// (SlowFeatures), which suppresses noise. A slow nuisance, such as a distractor at rest, has no
/// gradient.
///
/// The result does not depend on the order of the demonstrations.
class ActionDirections {
 public:
  /// @param demonstrations  scores as states (T + 1 x p), actions as controls (T x m), finite.
  /// @param blocks          columns of each block. Other columns also explain actions.
  /// @throws std::invalid_argument if a block does not vary.
  ActionDirections(std::span<const core::Trajectory> demonstrations,
                   std::span<const std::vector<int>> blocks);

  /// Returns weights that combine the scores of a block into `components` components, one per row.
  /// The components are the slow features, slowest first, of the subspace that the first
  /// `components` directions span. Returns fewer rows if there are fewer directions.
  [[nodiscard]] core::Matrix Weights(std::size_t block, int components) const;

 private:
  struct Block {
    core::Matrix slow;         // Directions of slow features, one per row.
    Eigen::VectorXd slowness;  // Variances of the slow features.
    Eigen::MatrixXd relevant;  // One column per direction, in slow features; orthonormal.
  };
  std::vector<Block> blocks_;
};

}  // namespace dfr::reduction
