#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/core/features/features.h"
#include "dfr/core/matrix.h"

namespace dfr::core {

/// Options for FeatureTransform::Whitening().
struct WhiteningOptions {
  /// Added to the diagonal of the correlation matrix, > 0. It limits the scaling of directions in
  /// which the demonstrations do not vary to 1/sqrt(ridge).
  double ridge = 0.03;
  /// If false, each feature is only divided by its standard deviation.
  bool decorrelate = true;
  /// If true, uses differences of states from their neighbours, which separates different ways to
  /// do a task. If false, uses differences from the mean.
  bool local = true;
};

/// Map from a state to the coordinates in which distances are measured: z = W (f(x) - offset), with
/// f(x) the selected entries of the state.
///
/// Immutable. Concurrent calls are safe.
class FeatureTransform {
 public:
  static constexpr int kMaxFeatures = 256;

  /// @throws std::invalid_argument if `offset` or the columns of `scale` do not match the selected
  ///   features, there are more than kMaxFeatures, or an entry is not finite.
  FeatureTransform(FeatureSelection selection, Eigen::VectorXd offset, Matrix scale);

  /// Returns the transform z = f(x).
  static FeatureTransform Identity(FeatureSelection selection);

  /// Returns the transform with W = (Corr + ridge I)^(-1/2) diag(1/sd). Corr and sd describe how
  /// demonstrated states differ from their neighbours at the same time step (LocalScatter()),
  /// pooled over all t at which at least half of the demonstrations are still running. z therefore
  /// has about unit variance across demonstrations, for any units. Progress of the task does not
  /// count as variance. If a feature moves in the same way in all demonstrations, its sd is its
  /// root mean square change per time step.
  /// @param demonstrations  one matrix of whole states per demonstration, rows in time order.
  /// @throws std::invalid_argument if there are more than kMaxFeatures or fewer than two
  ///   demonstrations, their widths do not match the selection, the ridge is not positive, or no
  ///   selected feature differs between them.
  static FeatureTransform Whitening(FeatureSelection selection,
                                    std::span<const Matrix> demonstrations,
                                    const WhiteningOptions& options = {});

  [[nodiscard]] int state_dim() const noexcept { return selection_.state_dim(); }
  [[nodiscard]] int num_features() const noexcept { return static_cast<int>(scale_.rows()); }
  [[nodiscard]] const FeatureSelection& selection() const noexcept { return selection_; }
  [[nodiscard]] const Matrix& scale() const noexcept { return scale_; }
  [[nodiscard]] const Eigen::VectorXd& offset() const noexcept { return offset_; }

  /// Writes z of one state (state_dim() entries) to `features` (num_features()). Never allocates.
  void Apply(std::span<const double> state, std::span<double> features) const noexcept;
  /// Returns z of each row.
  [[nodiscard]] Matrix Apply(const Matrix& states) const;

 private:
  FeatureSelection selection_;
  Eigen::VectorXd offset_;
  Matrix scale_;
};

/// Returns the median number of states per demonstration: at least half of the demonstrations have
/// at least that many. @throws std::invalid_argument if there is no demonstration.
[[nodiscard]] int MedianNumStates(std::span<const Matrix> demonstrations);

}  // namespace dfr::core
