#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"

namespace dfr::imitation {

/// Standardisation of each feature: z = (x - mean) / scale. Does not rotate: each entry of z
/// depends on one feature. Immutable; concurrent calls are safe.
class Whitening {
 public:
  /// Returns the map z = x.
  static Whitening Identity(int dim);

  /// Uses mean and standard deviation (divisor n) of the rows of `samples`. A feature that is
  /// constant up to rounding (deviation below 1e-9 of its magnitude) gets scale 1.
  /// @throws std::invalid_argument if there is no row or no column, or an entry is not finite.
  static Whitening FromData(const core::Matrix& samples);

  /// @throws std::invalid_argument if sizes differ, an entry is not finite, or a scale is
  /// not positive.
  Whitening(Eigen::VectorXd mean, Eigen::VectorXd scale);

  [[nodiscard]] int dim() const noexcept { return static_cast<int>(mean_.size()); }
  [[nodiscard]] const Eigen::VectorXd& mean() const noexcept { return mean_; }
  [[nodiscard]] const Eigen::VectorXd& scale() const noexcept { return scale_; }

  /// Maps x to z. Both have dim() entries and may be the same memory. Never allocates.
  void Apply(std::span<const double> x, std::span<double> z) const noexcept;
  /// Maps each row. @throws std::invalid_argument for another number of columns.
  [[nodiscard]] core::Matrix Apply(const core::Matrix& samples) const;

  void Save(core::ArchiveWriter& archive) const;
  /// @throws std::runtime_error naming the file.
  static Whitening Load(core::ArchiveReader& archive);

 private:
  Eigen::VectorXd mean_;
  Eigen::VectorXd scale_;
};

}  // namespace dfr::imitation
