#pragma once

#include <cstdint>
#include <span>
#include <vector>

namespace dfr::reduction {

/// 8-bit picture with interleaved channels, rows from the top. Borrowed. For a cv::Mat m of type
/// CV_8UC1 or CV_8UC3, use {m.data, m.cols, m.rows, m.channels(), m.step}.
struct PictureView {
  const std::uint8_t* data = nullptr;
  int width = 0;
  int height = 0;
  int channels = 3;        ///< 1: grey. 3: colour, in the order of ImageFeaturesOptions.
  std::size_t stride = 0;  ///< Bytes from one row to the next, >= channels width.
};

/// Reason why a picture has no features.
enum class PictureFault {
  kNone,
  kWrongSize,  ///< Unexpected size or number of channels, a stride that is too small, or no data.
  kDark,       ///< Black: darker than ImageFeaturesOptions::least_mean.
  kFrozen,     ///< Identical to the previous pictures. A working sensor has noise.
};

/// Order of the channels of a colour picture: BGR as in OpenCV, or RGB as in datasets.
enum class ChannelOrder { kBgr, kRgb };

/// Mean and standard deviation of the pixels of a picture after normalisation.
inline constexpr double kNormalMean = 128.0;
inline constexpr double kNormalDeviation = 48.0;

/// Method by which ImageFeatures normalises the light of a picture.
enum class LightNormalisation {
  kNone,
  kGain,           ///< Scales to a mean of 128, which removes changes of brightness.
  kGainAndOffset,  ///< Scales and shifts to a mean of 128 and a standard deviation of 48.
};

/// Options for ImageFeatures.
struct ImageFeaturesOptions {
  int width = 0;  ///< Size of the pictures.
  int height = 0;
  int channels = 3;
  ChannelOrder order = ChannelOrder::kRgb;
  /// Used part of the picture: first column and row, and size; a size of 0 extends to the edge.
  int crop_x = 0;
  int crop_y = 0;
  int crop_width = 0;
  int crop_height = 0;
  /// Size after averaging, at most the size of the used part; 0: the same size.
  int out_width = 0;
  int out_height = 0;
  bool grey = false;  ///< Converts three channels to one, 0.299 R + 0.587 G + 0.114 B.
  LightNormalisation light = LightNormalisation::kGain;
  double least_mean = 4.0;  ///< Lower limit of the mean, in [0, 255]. A darker picture is kDark.
  /// Number of consecutive identical pictures that indicate a frozen camera; 0: never, for
  /// simulators.
  int frozen_after = 0;
};

/// Converts pictures to vectors of floats: crops, averages over areas, converts to grey, and
/// normalises the light. A reduction::Reduction takes the result.
///
/// Each object belongs to one camera and one thread. Apply() never allocates, locks or throws.
class ImageFeatures {
 public:
  /// @throws std::invalid_argument naming the option that is out of range.
  explicit ImageFeatures(const ImageFeaturesOptions& options);

  /// Number of features: out_height x out_width x channels, in this order.
  [[nodiscard]] int size() const noexcept { return static_cast<int>(rows_.size()) * row_floats_; }

  /// Discards the previous picture. Call this at the start of an episode.
  void Reset() noexcept { identical_ = 0; }

  /// Writes the features of `picture` to `features` (size()).
  /// @returns kNone, or the fault. After a fault, all `features` are NaN, which every support
  /// treats as outside.
  PictureFault Apply(const PictureView& picture, std::span<float> features) noexcept;

  /// Distributes each feature's value (size() values), such as its share of a level, over the
  /// averaged pixels in proportion to their weights. Adds the result to `pixels` (height x width x
  /// channels entries), whose sum grows by the sum of the values. Ignores the normalisation of
  /// light.
  void Spread(std::span<const double> features, std::span<double> pixels) const noexcept;

  [[nodiscard]] const ImageFeaturesOptions& options() const noexcept { return options_; }

 private:
  /// Inputs first, ..., first + weights.size() - 1 contribute to one output.
  struct Average {
    int first = 0;
    std::vector<float> weights;
  };
  static std::vector<Average> Averages(int in, int out);
  PictureFault Check(const PictureView& picture) noexcept;
  void Resample(const PictureView& picture, std::span<float> features) noexcept;
  PictureFault Normalise(std::span<float> features) const noexcept;

  ImageFeaturesOptions options_;
  std::vector<Average> rows_;
  std::vector<Average> columns_;
  int out_channels_ = 0;
  int row_floats_ = 0;              ///< Number of floats of one output row.
  std::vector<float> row_;          ///< One output row before its columns are averaged.
  std::vector<std::uint8_t> last_;  ///< Previous picture.
  int identical_ = 0;  ///< Number of consecutive pictures equal to `last_`; 0: none yet.
};

}  // namespace dfr::reduction
