#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>

#include "dfr/core/features/features.h"
#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"
#include "dfr/reduction/row_source.h"

namespace dfr::reduction {

/// Options for FeaturePoints::Fit().
struct FeaturePointsOptions {
  int points = 16;         ///< Number of patches, in [1, kMostPoints].
  int side = 5;            ///< Height and width of a patch in pixels, in [1, kMostSide].
  double sharpness = 5.0;  ///< beta, > 0. Larger values weight the best window more.
  int samples = 20000;     ///< Maximum number of windows to draw; >= points.
  int iterations = 30;     ///< Steps of k-means, >= 1.
  std::uint64_t seed = 5;
};

/// Map from the pixels of a picture to the positions of patches, two numbers per patch.
///
/// Each patch c (side x side pixels, all channels) is compared with each window w of the picture.
/// The patch's position is the expected column and row under the weights softmax(-beta mean((w -
/// c)^2)) over all windows, scaled from 0 for the first window to 1 for the last (spatial softmax;
/// Levine et al., JMLR 17, 2016; Finn et al., ICRA 2016). If a picture shows the patch twice, its
/// position is halfway between the two places.
///
/// Pixel values come from ImageFeatures with LightNormalisation::kGainAndOffset: mean 128 and
/// standard deviation 48. Immutable. Concurrent calls with separate workspaces are safe.
class FeaturePoints {
 public:
  static constexpr int kMostPoints = 64;
  static constexpr int kMostSide = 7;
  /// Largest height and width of a picture.
  static constexpr int kMostPixelsASide = 128;

  /// Scratch memory of one thread.
  class Workspace {
   public:
    Workspace() = default;
    explicit Workspace(const FeaturePoints& points);

   private:
    friend class FeaturePoints;
    Eigen::VectorXf picture_;  // Picture in units of the standard deviation.
    Eigen::MatrixXf windows_;  // Windows of one picture row, one per column.
    Eigen::MatrixXf logits_;   // points x windows; weights after the softmax.
  };

  /// @param shape    height and width in [side, kMostPixelsASide], and channels.
  /// @param patches  points x (side side channels), in units of the standard deviation: rows from
  ///   the top, interleaved channels.
  /// @throws std::invalid_argument if a size does not match or is out of range, or a value is not
  ///   finite or exceeds 1e6 in magnitude.
  FeaturePoints(const core::PictureShape& shape, int side, double sharpness, core::Matrix patches);

  /// Checks the shape of pictures for the constructor and Fit().
  /// @throws std::invalid_argument if a size is out of range.
  static void CheckShape(const core::PictureShape& shape, int side = FeaturePointsOptions().side);

  /// Finds patches by k-means on the random windows whose variance is above the median (Coates and
  /// Ng, AISTATS 2011). Reads the pictures once.
  /// @param pictures  height x width x channels entries per row.
  /// @throws std::invalid_argument if an option is out of range, the pictures are smaller than a
  /// patch or larger than kMostPixelsASide, or all windows have a single colour.
  static FeaturePoints Fit(const RowSource& pictures, const core::PictureShape& shape,
                           const FeaturePointsOptions& options = {});

  [[nodiscard]] const core::PictureShape& shape() const noexcept { return shape_; }
  [[nodiscard]] int num_points() const noexcept { return static_cast<int>(patches_.rows()); }
  /// Returns the number of positions: column and row of each patch.
  [[nodiscard]] int size() const noexcept { return 2 * num_points(); }
  [[nodiscard]] const core::Matrix& patches() const noexcept { return patches_; }

  /// Writes column and row of each patch to `positions` (size()). Never allocates, locks or throws.
  /// For a picture of the wrong size or with a non-finite entry, all positions are NaN.
  void Apply(std::span<const float> picture, Workspace& workspace,
             std::span<double> positions) const noexcept;

  /// Distributes each patch's value (num_points() values) over the pixels of all windows, in
  /// proportion to the windows' weights in the last Apply() with `workspace`. Adds the result to
  /// `pixels`, whose sum grows by the sum of the values.
  void Spread(std::span<const double> values, const Workspace& workspace,
              std::span<double> pixels) const;

  /// Appends all data except the shape to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and its defect.
  static FeaturePoints Load(core::ArchiveReader& archive, const core::PictureShape& shape);

 private:
  [[nodiscard]] Eigen::Index rows() const noexcept { return shape_.height - side_ + 1; }
  [[nodiscard]] Eigen::Index columns() const noexcept { return shape_.width - side_ + 1; }

  core::PictureShape shape_;
  int side_ = 0;
  double sharpness_ = 0.0;
  core::Matrix patches_;
  float factor_ = 0.0F;      // beta divided by the number of entries of a patch.
  Eigen::MatrixXf weights_;  // 2 factor_ patches_.
  Eigen::VectorXf offset_;   // -factor_ times the squared norms of the patches.
};

}  // namespace dfr::reduction
