#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/core/features/features.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"
#include "dfr/reduction/row_source.h"

namespace dfr::reduction {

/// Measures the difference between a picture and all demonstrations, relative to the differences
/// between left-out and other demonstrations.
///
/// Two statistics, each divided by its limit:
/// - the largest mean squared difference from the mean picture on a window of 3 x 3 pixels, divided
///   by the sum of the demonstrations' variance there, kFloor^2 and the squared change of the mean
///   picture for a camera shift of one pixel,
/// - Hotelling's T^2 of the positions of patches (FeaturePoints), if there are any, with kRidge of
///   the mean variance added to each variance.
/// A limit is kMargin max(1, v). The maximum of the statistic over an episode exceeds v in at most
/// 5 % of the demonstrations, each measured with the mean and the variances of the other folds.
///
/// Immutable. Concurrent calls with separate workspaces are safe.
class Novelty {
 public:
  static constexpr double kMargin = 3.0;
  /// Minimum relevant difference, in units of a pixel's value.
  static constexpr double kFloor = 4.0;
  static constexpr double kRidge = 1e-3;

  /// Scratch memory of one thread.
  class Workspace {
   public:
    Workspace() = default;
    explicit Workspace(const Novelty& novelty);

   private:
    friend class Novelty;
    Eigen::VectorXf squares_;    // Squared differences, one per pixel.
    Eigen::VectorXd positions_;  // Differences from the mean positions.
    Eigen::VectorXd whitened_;   // Positions whitened to unit variance.
  };

  /// Fits to pictures of at least two demonstrations.
  /// @param pictures  height x width x channels entries per row, as computed by ImageFeatures.
  /// @param begin      first row of each demonstration, then the number of rows.
  /// @param positions  positions of the patches, one matrix per demonstration, one row per picture;
  ///   empty: none.
  /// @throws std::invalid_argument if sizes do not match, there are fewer than two demonstrations,
  ///   or one is empty.
  static Novelty Fit(const RowSource& pictures, const core::PictureShape& shape,
                     std::span<const Eigen::Index> begin, std::span<const core::Matrix> positions);

  /// Returns the larger statistic in units of its limit. Above 1, the picture resembles no
  /// demonstration. Returns infinity for a wrong size and for NaN. Never allocates, locks or
  /// throws.
  [[nodiscard]] double Of(std::span<const float> picture, std::span<const double> positions,
                          Workspace& workspace) const noexcept;

  /// Returns the fraction of the demonstrations that have a picture with Of() > 1, each measured
  /// while left out.
  [[nodiscard]] double left_out() const noexcept { return left_out_; }
  [[nodiscard]] const core::PictureShape& shape() const noexcept { return shape_; }
  /// Returns the number of positions.
  [[nodiscard]] int num_positions() const noexcept { return static_cast<int>(middle_.size()); }

  /// Appends all data except the shape to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and its defect.
  static Novelty Load(core::ArchiveReader& archive, const core::PictureShape& shape);

 private:
  struct Statistics {
    double picture = 0.0;
    double positions = 0.0;
  };

  /// @param variance   variance of each window.
  /// @param middle     mean positions.
  /// @param whitening  map of positions to unit variance.
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
