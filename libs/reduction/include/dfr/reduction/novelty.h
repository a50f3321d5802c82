#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/core/archive.h"
#include "dfr/core/features.h"
#include "dfr/core/matrix.h"
#include "dfr/reduction/row_source.h"

namespace dfr::reduction {

/// How much a picture differs from all demonstrations, compared with left-out demonstrations.
///
/// Two statistics, each divided by its limit:
/// - the largest mean squared difference from the mean picture on a window of 3 x 3 pixels, in
///   units of the demonstrations' variance there plus kFloor^2 plus the square of what a shift of
///   the camera by a pixel changes in the mean picture,
/// - Hotelling's T^2 of the positions of patches (FeaturePoints), if there are any, with kRidge of
///   the mean variance added to each variance.
/// A limit is kMargin times the maximum in an episode that at most 5 % of the demonstrations
/// exceeded when mean and variances were those of the other four fifths.
///
/// Immutable. Concurrent calls with separate workspaces are safe.
class Novelty {
 public:
  static constexpr double kMargin = 3.0;
  /// In units of a pixel's value: smaller differences are none.
  static constexpr double kFloor = 4.0;
  static constexpr double kRidge = 1e-3;

  /// Memory of one thread.
  class Workspace {
   public:
    Workspace() = default;
    explicit Workspace(const Novelty& novelty);

   private:
    friend class Novelty;
    Eigen::VectorXf squares_;    // One for each pixel.
    Eigen::VectorXd positions_;  // Differences,
    Eigen::VectorXd whitened_;   // and those of unit variance.
  };

  /// Fits to pictures of at least two demonstrations.
  /// @param pictures   height x width x channels entries a row, as ImageFeatures makes them.
  /// @param begin      first row of each demonstration, then the number of rows.
  /// @param positions  of each demonstration, the positions in its rows; empty: none.
  /// @throws std::invalid_argument if sizes do not fit, there are fewer than two demonstrations, or
  ///   one is empty.
  static Novelty Fit(const RowSource& pictures, const core::PictureShape& shape,
                     std::span<const Eigen::Index> begin, std::span<const core::Matrix> positions);

  /// Returns the larger statistic in units of its limit: above 1 a picture resembles no
  /// demonstration. Never allocates, locks or throws. Infinity for a wrong size and NaN.
  [[nodiscard]] double Of(std::span<const float> picture, std::span<const double> positions,
                          Workspace& workspace) const noexcept;

  /// Share of the demonstrations, each left out, with a picture above 1.
  [[nodiscard]] double left_out() const noexcept { return left_out_; }
  [[nodiscard]] const core::PictureShape& shape() const noexcept { return shape_; }
  /// Number of positions.
  [[nodiscard]] int num_positions() const noexcept { return static_cast<int>(middle_.size()); }

  /// Appends all except the shape to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and its defect.
  static Novelty Load(core::ArchiveReader& archive, const core::PictureShape& shape);

 private:
  struct Statistics {
    double picture = 0.0;
    double positions = 0.0;
  };

  /// @param variance   of each window.
  /// @param middle     mean positions.
  /// @param whitening  of positions, to unit variance.
  Novelty(const core::PictureShape& shape, Eigen::VectorXd mean, Eigen::VectorXd variance,
          Eigen::VectorXd middle, core::Matrix whitening);
  void CheckLimits() const;
  [[nodiscard]] Statistics Measure(std::span<const float> picture,
                                   std::span<const double> positions,
                                   Workspace& workspace) const noexcept;

  core::PictureShape shape_;
  Eigen::VectorXd mean_;
  Eigen::VectorXd variance_;
  Eigen::VectorXd middle_;
  core::Matrix whitening_;
  Statistics limit_{.picture = 1.0, .positions = 1.0};
  double left_out_ = 0.0;
  Eigen::VectorXf mean_of_pixels_;
  Eigen::VectorXf inverse_variance_;
};

}  // namespace dfr::reduction
