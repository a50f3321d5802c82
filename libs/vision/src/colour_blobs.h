#pragma once

#include <Eigen/Core>
#include <array>
#include <opencv2/core.hpp>
#include <vector>

#include "dfr/vision/line_vision.h"

namespace dfr::vision::internal {

struct Blob {
  Eigen::Vector2d center;
  double area = 0.0;  ///< in pixels; a partly covered pixel counts fractionally
  bool round = false;
};

/// Regions of a picture that have one colour. Allocates for the first picture.
struct ColourBlobs {
  std::array<cv::Mat, 3> channels;  ///< blue, green, red
  cv::Mat other;                    ///< scratch of Excess(): maximum of the two other channels
  cv::Mat excess;                   ///< excess of one channel over both others, 0 where negative
  cv::Mat mask;
  cv::Mat labels;
  cv::Mat stats;
  cv::Mat centroids;
  std::vector<Blob> blobs;

  void Split(const ImageView& image);
  /// Computes the excess of channel `c` over both others.
  void Excess(int c);
  /// Finds connected regions of the current excess above `threshold`. May omit those whose area, as
  /// Blob::area, exceeds `max_area`.
  void FindBlobs(double threshold, double max_area);
  /// Computes the sub-pixel centre and area: edge pixels count in proportion to their colour.
  Blob Refine(const int* row, double threshold) const;
};

}  // namespace dfr::vision::internal
