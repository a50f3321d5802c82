#include "colour_blobs.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <opencv2/imgproc.hpp>

namespace dfr::vision::internal {

void ColourBlobs::Split(const ImageView& image) {
  const cv::Mat view(image.height, image.width, CV_8UC3,
                     const_cast<std::uint8_t*>(image.data),  // read only
                     image.stride);
  cv::split(view, channels.data());
}

void ColourBlobs::FindBlobs(double threshold, double max_area) {
  cv::threshold(excess, mask, threshold, 255.0, cv::THRESH_BINARY);
  const int count = cv::connectedComponentsWithStats(mask, labels, stats, centroids, 8, CV_16U);
  blobs.clear();
  for (int i = 1; i < count; ++i) {
    const int* row = stats.ptr<int>(i);
    const int pixels = row[cv::CC_STAT_AREA];
    // A third of a region's pixels count fully (Refine).
    if (pixels < 6 || pixels > 3.0 * (max_area + 1.0)) continue;
    blobs.push_back(Refine(row, threshold));
  }
}

void ColourBlobs::Excess(int c) {
  const auto i = static_cast<std::size_t>(c);
  cv::max(channels[(i + 1) % 3], channels[(i + 2) % 3], other);
  cv::subtract(channels[i], other, excess);
}

Blob ColourBlobs::Refine(const int* row, double threshold) const {
  const int x0 = std::max(0, row[cv::CC_STAT_LEFT] - 2);
  const int y0 = std::max(0, row[cv::CC_STAT_TOP] - 2);
  const int x1 = std::min(excess.cols, row[cv::CC_STAT_LEFT] + row[cv::CC_STAT_WIDTH] + 2);
  const int y1 = std::min(excess.rows, row[cv::CC_STAT_TOP] + row[cv::CC_STAT_HEIGHT] + 2);
  std::array<int, 256> histogram{};
  for (int y = y0; y < y1; ++y) {
    const std::uint8_t* p = excess.ptr<std::uint8_t>(y);
    for (int x = x0; x < x1; ++x) ++histogram[p[x]];
  }
  // Full colour is a high quantile of the values above the threshold, which is robust to noise.
  int remaining = row[cv::CC_STAT_AREA] / 3;
  int full = 255;
  while (full > threshold && remaining > 0)
    remaining -= histogram[static_cast<std::size_t>(full--)];
  // Pixels below a fifth of full colour are noisy background; those above four fifths count fully.
  const double low = 0.2 * full;
  const double high = 0.8 * full;
  double sum = 0.0;
  double sum_x = 0.0;
  double sum_y = 0.0;
  for (int y = y0; y < y1; ++y) {
    const std::uint8_t* p = excess.ptr<std::uint8_t>(y);
    for (int x = x0; x < x1; ++x) {
      const double w = std::clamp((p[x] - low) / (high - low), 0.0, 1.0);
      sum += w;
      sum_x += w * x;
      sum_y += w * y;
    }
  }
  Blob blob;
  blob.area = sum;
  blob.center = {sum_x / sum, sum_y / sum};
  const double aspect =
      static_cast<double>(row[cv::CC_STAT_WIDTH]) / static_cast<double>(row[cv::CC_STAT_HEIGHT]);
  const double box =
      static_cast<double>(row[cv::CC_STAT_WIDTH]) * static_cast<double>(row[cv::CC_STAT_HEIGHT]);
  const bool inside = row[cv::CC_STAT_LEFT] > 0 && row[cv::CC_STAT_TOP] > 0 &&
                      row[cv::CC_STAT_LEFT] + row[cv::CC_STAT_WIDTH] < excess.cols &&
                      row[cv::CC_STAT_TOP] + row[cv::CC_STAT_HEIGHT] < excess.rows;
  blob.round = inside && aspect > 0.7 && aspect < 1.43 && row[cv::CC_STAT_AREA] > 0.6 * box;
  return blob;
}

}  // namespace dfr::vision::internal
