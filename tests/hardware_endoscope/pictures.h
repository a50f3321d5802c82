#pragma once

#include <cstdint>
#include <opencv2/core.hpp>

#include "dfr/core/random.h"
#include "dfr/dds/messages.h"
#include "dfr/hardware/endoscope.h"

namespace dfr::test {

constexpr int kWidth = 64;
constexpr int kHeight = 48;

/// Options for kWidth x kHeight pictures without an age limit. Tests with their own clock set a
/// limit.
inline hardware::EndoscopeOptions SmallPictures() {
  hardware::EndoscopeOptions options;
  options.width = kWidth;
  options.height = kHeight;
  options.max_age_s = 1e5;
  options.max_ahead_s = 1e5;
  return options;
}

/// Returns noise over grey. Pictures of different seeds differ.
inline cv::Mat Noise(std::uint64_t seed, int width = kWidth, int height = kHeight) {
  core::Random random(seed);
  cv::Mat picture(height, width, CV_8UC3);
  for (int i = 0; i < 3 * width * height; ++i) {
    picture.data[i] = static_cast<std::uint8_t>(100 + random.Below(50));
  }
  return picture;
}

inline dds::Image Message(const cv::Mat& picture, std::int64_t stamp_ns,
                          const std::string& encoding = "bgr8") {
  dds::Image image;
  image.stamp = dds::Stamp::FromNanoseconds(stamp_ns);
  image.width = static_cast<std::uint32_t>(picture.cols);
  image.height = static_cast<std::uint32_t>(picture.rows);
  image.encoding = encoding;
  image.step = static_cast<std::uint32_t>(picture.step);
  image.data.assign(picture.data, picture.data + picture.total() * picture.elemSize());
  return image;
}

}  // namespace dfr::test
