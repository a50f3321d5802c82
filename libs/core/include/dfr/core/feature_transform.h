#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/core/features.h"
#include "dfr/core/matrix.h"

namespace dfr::core {

/// Options for FeatureTransform::Whitening().
struct WhiteningOptions {
  /// Added to the diagonal of the correlation matrix, > 0: directions that the demonstrations never
  /// moved in are not blown up beyond 1/sqrt(ridge).
  double ridge = 0.03;
  /// Off: each feature is only divided by its standard deviation.
  bool decorrelate = true;
  /// How states differ: from their neighbours, so that several ways to do a task are not taken for
  /// one wide one. Off: from the mean.
  bool local = true;
};

/// Features as distances see them: z = W (f(x) - offset), f(x) the selected entries of a state.
///
/// Immutable. Concurrent calls are safe.
class FeatureTransform {
 public:
  /// @throws std::invalid_argument if `offset` does not have one entry, or `scale` not one column,
  ///   per selected feature, or if an entry is not finite.
  FeatureTransform(FeatureSelection selection, Eigen::VectorXd offset, Matrix scale);

  /// z = f(x).
  static FeatureTransform Identity(FeatureSelection selection);

  /// W = (Corr + ridge I)^(-1/2) diag(1/sd), of how demonstrated states differ from their
  /// neighbours at the same time step (LocalScatter()), pooled over all t at which at least half of
  /// the demonstrations are still under way. So z has about unit variance across demonstrations,
  /// whatever the units, and progress of the task does not count as variance. `demonstrations` has
  /// one matrix of whole states each, rows in order of time.
  /// @throws std::invalid_argument if there are fewer than two demonstrations, their widths do not
  ///   fit, a ridge is not positive, or no selected feature differs between them.
  static FeatureTransform Whitening(FeatureSelection selection,
                                    std::span<const Matrix> demonstrations,
                                    const WhiteningOptions& options = {});

  [[nodiscard]] int state_dim() const noexcept { return selection_.state_dim(); }
  [[nodiscard]] int num_features() const noexcept { return static_cast<int>(scale_.rows()); }
  [[nodiscard]] const FeatureSelection& selection() const noexcept { return selection_; }
  [[nodiscard]] const Matrix& scale() const noexcept { return scale_; }
  [[nodiscard]] const Eigen::VectorXd& offset() const noexcept { return offset_; }

  /// z of one state (state_dim() entries) to `features` (num_features()). Never allocates; at most
  /// FeatureDecision::kMaxFeatures features.
  void Apply(std::span<const double> state, std::span<double> features) const noexcept;
  /// z of each row.
  [[nodiscard]] Matrix Apply(const Matrix& states) const;

 private:
  FeatureSelection selection_;
  Eigen::VectorXd offset_;
  Matrix scale_;
};

/// How many states the demonstration of median length has: until then at least half of them are
/// under way. @throws std::invalid_argument if there are none.
[[nodiscard]] int MedianNumStates(std::span<const Matrix> demonstrations);

}  // namespace dfr::core
