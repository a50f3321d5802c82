#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"
#include "dfr/reduction/principal_components.h"

namespace dfr::reduction {

/// Linear map from a high-dimensional block x (d entries) to k components,
///   z = P ((x - mean) / scale).
/// Entries with scale 0 never varied in the fit and are ignored.
///
/// Immutable. Concurrent calls are safe. Apply() of one state never allocates, locks or throws and
/// may be called in the control loop. Weights are in float, and sums over more than 512 entries are
/// in double. The same values give the same z for every type of x.
class Reduction {
 public:
  /// Maximum d and maximum k.
  static constexpr int kMaxInputs = 1 << 20;
  static constexpr int kMaxComponents = 256;

  /// @param mean        d entries.
  /// @param scale       d entries, each >= 0.
  /// @param projection  P, k x d.
  /// @throws std::invalid_argument if sizes do not match or exceed the maxima, a scale is negative,
  ///   or an entry is not finite.
  Reduction(Eigen::VectorXd mean, Eigen::VectorXd scale, core::Matrix projection);

  /// Returns the projection onto the first `components` principal components.
  /// @throws std::invalid_argument if there are fewer components.
  static Reduction Principal(const PrincipalComponents& fit, int components);

  [[nodiscard]] int input_dim() const noexcept { return static_cast<int>(mean_.size()); }
  [[nodiscard]] int num_components() const noexcept { return static_cast<int>(projection_.rows()); }
  [[nodiscard]] const Eigen::VectorXd& mean() const noexcept { return mean_; }
  [[nodiscard]] const Eigen::VectorXd& scale() const noexcept { return scale_; }
  [[nodiscard]] const core::Matrix& projection() const noexcept { return projection_; }

  /// Writes the components of `x` (input_dim()) to `z` (num_components()). A wrong size of x or a
  /// non-finite entry, even an ignored one, makes z non-finite. Supports then treat the state as
  /// outside.
  void Apply(std::span<const double> x, std::span<double> z) const noexcept;
  void Apply(std::span<const float> x, std::span<double> z) const noexcept;

  /// Appends this object to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote.
  /// @throws std::runtime_error naming the file and its defect.
  static Reduction Load(core::ArchiveReader& archive);

 private:
  template <typename Value>
  void Project(std::span<const Value> x, std::span<double> z) const noexcept;

  Eigen::VectorXd mean_;
  Eigen::VectorXd scale_;
  core::Matrix projection_;
  /// P diag(1 / scale), k x d.
  Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> weights_;
};

}  // namespace dfr::reduction
