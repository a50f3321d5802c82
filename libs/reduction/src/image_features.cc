#include "dfr/reduction/image_features.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>

#include "dfr/core/contract.h"

namespace dfr::reduction {
namespace {

constexpr int kMostPixels = 1 << 13;  // Largest width and height.

// Returns the weights of a colour picture's channels for conversion to grey.
std::array<float, 3> GreyWeights(ChannelOrder order) noexcept {
  if (order == ChannelOrder::kRgb) return {0.299F, 0.587F, 0.114F};
  return {0.114F, 0.587F, 0.299F};
}

void CheckPart(const char* name, int first, int size, int all) {
  DFR_THROW_UNLESS(first >= 0 && size >= 1 && size <= all - first,
                   name << ": the part from " << first << " of size " << size
                        << " must lie within the " << all << " pixels of the picture");
}

}  // namespace

ImageFeatures::ImageFeatures(const ImageFeaturesOptions& options) : options_(options) {
  ImageFeaturesOptions& o = options_;
  DFR_THROW_UNLESS(
      o.width >= 1 && o.height >= 1 && o.width <= kMostPixels && o.height <= kMostPixels,
      "width and height must lie in [1, " << kMostPixels << "], not " << o.width << " and "
                                          << o.height);
  DFR_THROW_UNLESS(o.channels == 1 || o.channels == 3,
                   "channels must be 1 or 3, not " << o.channels);
  DFR_THROW_UNLESS(o.least_mean >= 0.0 && o.least_mean <= 255.0,
                   "least_mean must lie in [0, 255], not " << o.least_mean);
  DFR_THROW_UNLESS(o.frozen_after == 0 || o.frozen_after >= 2,
                   "frozen_after must be 0 or at least 2, not " << o.frozen_after);
  if (o.crop_width == 0) o.crop_width = o.width - o.crop_x;
  if (o.crop_height == 0) o.crop_height = o.height - o.crop_y;
  CheckPart("crop_x, crop_width", o.crop_x, o.crop_width, o.width);
  CheckPart("crop_y, crop_height", o.crop_y, o.crop_height, o.height);
  if (o.out_width == 0) o.out_width = o.crop_width;
  if (o.out_height == 0) o.out_height = o.crop_height;
  DFR_THROW_UNLESS(o.out_width >= 1 && o.out_width <= o.crop_width && o.out_height >= 1 &&
                       o.out_height <= o.crop_height,
                   "out_width and out_height must lie in [1, "
                       << o.crop_width << "] and [1, " << o.crop_height << "], not " << o.out_width
                       << " and " << o.out_height);
  rows_ = Averages(o.crop_height, o.out_height);
  columns_ = Averages(o.crop_width, o.out_width);
  out_channels_ = o.grey ? 1 : o.channels;
  row_floats_ = o.out_width * out_channels_;
  row_.resize(static_cast<std::size_t>(o.crop_width) * static_cast<std::size_t>(out_channels_));
  if (o.frozen_after > 0) {
    last_.resize(static_cast<std::size_t>(o.width) * static_cast<std::size_t>(o.height) *
                 static_cast<std::size_t>(o.channels));
  }
}

std::vector<ImageFeatures::Average> ImageFeatures::Averages(int in, int out) {
  std::vector<Average> averages(static_cast<std::size_t>(out));
  const double width = static_cast<double>(in) / out;
  for (int i = 0; i < out; ++i) {
    Average& average = averages[static_cast<std::size_t>(i)];
    const double begin = i * width;
    const double end = std::min<double>(in, (i + 1) * width);
    average.first = static_cast<int>(begin);
    for (int j = average.first; j < in && j < end; ++j) {
      const double covered = std::min<double>(end, j + 1) - std::max<double>(begin, j);
      average.weights.push_back(static_cast<float>(covered / (end - begin)));
    }
  }
  return averages;
}

PictureFault ImageFeatures::Check(const PictureView& picture) noexcept {
  const std::size_t bytes =
      static_cast<std::size_t>(options_.width) * static_cast<std::size_t>(options_.channels);
  if (picture.data == nullptr || picture.width != options_.width ||
      picture.height != options_.height || picture.channels != options_.channels ||
      picture.stride < bytes) {
    return PictureFault::kWrongSize;
  }
  if (options_.frozen_after == 0) return PictureFault::kNone;
  bool same = identical_ > 0;
  for (int y = 0; y < picture.height; ++y) {
    const std::uint8_t* now = picture.data + static_cast<std::size_t>(y) * picture.stride;
    std::uint8_t* before = last_.data() + static_cast<std::size_t>(y) * bytes;
    if (same && std::memcmp(now, before, bytes) == 0) continue;
    same = false;
    std::memcpy(before, now, bytes);
  }
  identical_ = same ? std::min(identical_ + 1, options_.frozen_after) : 1;
  return identical_ >= options_.frozen_after ? PictureFault::kFrozen : PictureFault::kNone;
}

void ImageFeatures::Resample(const PictureView& picture, std::span<float> features) noexcept {
  const bool mix = options_.grey && options_.channels == 3;
  const auto [first, middle, last] = GreyWeights(options_.order);
  float* out = features.data();
  for (const Average& row : rows_) {
    std::fill(row_.begin(), row_.end(), 0.0F);
    for (std::size_t j = 0; j < row.weights.size(); ++j) {
      const float weight = row.weights[j];
      const std::uint8_t* in =
          picture.data +
          static_cast<std::size_t>(options_.crop_y + row.first + static_cast<int>(j)) *
              picture.stride +
          static_cast<std::size_t>(options_.crop_x) * static_cast<std::size_t>(options_.channels);
      if (mix) {
        for (float& value : row_) {
          value += weight * (first * static_cast<float>(in[0]) +
                             middle * static_cast<float>(in[1]) + last * static_cast<float>(in[2]));
          in += 3;
        }
      } else {
        for (float& value : row_) value += weight * static_cast<float>(*in++);
      }
    }
    for (const Average& column : columns_) {
      for (int c = 0; c < out_channels_; ++c) {
        const float* in = row_.data() + column.first * out_channels_ + c;
        float sum = 0.0F;
        for (const float weight : column.weights) {
          sum += weight * *in;
          in += out_channels_;
        }
        *out++ = sum;
      }
    }
  }
}

PictureFault ImageFeatures::Normalise(std::span<float> features) const noexcept {
  double sum = 0.0;
  for (const float value : features) sum += static_cast<double>(value);
  const double mean = sum / static_cast<double>(features.size());
  if (mean < options_.least_mean) return PictureFault::kDark;
  if (options_.light == LightNormalisation::kNone || !(mean > 0.0)) return PictureFault::kNone;
  double gain = kNormalMean / mean;
  double offset = 0.0;
  if (options_.light == LightNormalisation::kGainAndOffset) {
    double square = 0.0;
    for (const float value : features) square += std::pow(static_cast<double>(value) - mean, 2);
    const double deviation = std::sqrt(square / static_cast<double>(features.size()));
    // A picture with a single colour has no contrast to scale.
    gain = deviation > 1.0 ? kNormalDeviation / deviation : 1.0;
    offset = kNormalMean - gain * mean;
  }
  for (float& value : features) {
    value = static_cast<float>(gain * static_cast<double>(value) + offset);
  }
  return PictureFault::kNone;
}

void ImageFeatures::Spread(std::span<const double> features,
                           std::span<double> pixels) const noexcept {
  const bool mix = options_.grey && options_.channels == 3;
  const std::array<float, 3> grey = GreyWeights(options_.order);
  const double* value = features.data();
  for (const Average& row : rows_) {
    for (const Average& column : columns_) {
      for (int c = 0; c < out_channels_; ++c, ++value) {
        for (std::size_t j = 0; j < row.weights.size(); ++j) {
          const int y = options_.crop_y + row.first + static_cast<int>(j);
          for (std::size_t i = 0; i < column.weights.size(); ++i) {
            const int x = options_.crop_x + column.first + static_cast<int>(i);
            const double share = *value * static_cast<double>(row.weights[j] * column.weights[i]);
            double* const pixel =
                pixels.data() +
                (static_cast<std::ptrdiff_t>(y) * options_.width + x) * options_.channels;
            if (!mix) {
              pixel[c] += share;
              continue;
            }
            for (std::size_t k = 0; k < grey.size(); ++k) {
              pixel[k] += share * static_cast<double>(grey[k]);
            }
          }
        }
      }
    }
  }
}

PictureFault ImageFeatures::Apply(const PictureView& picture, std::span<float> features) noexcept {
  PictureFault seen = PictureFault::kWrongSize;
  if (std::ssize(features) == size()) seen = Check(picture);
  if (seen == PictureFault::kNone) {
    Resample(picture, features);
    seen = Normalise(features);
  }
  if (seen != PictureFault::kNone) {
    std::fill(features.begin(), features.end(), std::numeric_limits<float>::quiet_NaN());
  }
  return seen;
}

}  // namespace dfr::reduction
