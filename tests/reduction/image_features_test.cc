#include "dfr/reduction/image_features.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::reduction {
namespace {

using testing::Each;
using testing::ElementsAre;
using testing::FloatEq;
using testing::FloatNear;
using testing::HasSubstr;
using testing::IsNan;
using testing::Pointwise;

ImageFeaturesOptions Grey(int width, int height) {
  ImageFeaturesOptions options{.width = width, .height = height, .channels = 1};
  options.light = LightNormalisation::kNone;
  return options;
}

PictureView View(const std::vector<std::uint8_t>& bytes, int width, int channels) {
  return {bytes.data(), width, static_cast<int>(bytes.size()) / (width * channels), channels,
          static_cast<std::size_t>(width * channels)};
}

std::vector<float> Features(const ImageFeaturesOptions& options, const PictureView& view) {
  ImageFeatures features(options);
  std::vector<float> out(static_cast<std::size_t>(features.size()));
  EXPECT_EQ(features.Apply(view, out), PictureFault::kNone);
  return out;
}

TEST(ImageFeaturesTest, AveragesAreasThatPixelsCoverInPart) {
  // From 3 x 2 to 2 x 1 pixels: the middle column belongs to both halves.
  const std::vector<std::uint8_t> bytes = {10, 40, 100, 30, 60, 200};
  ImageFeaturesOptions options = Grey(3, 2);
  options.out_width = 2;
  options.out_height = 1;
  EXPECT_THAT(Features(options, View(bytes, 3, 1)),
              ElementsAre(FloatNear((20.0F + 0.5F * 50.0F) / 1.5F, 1e-4F),
                          FloatNear((150.0F + 0.5F * 50.0F) / 1.5F, 1e-4F)));
}

TEST(ImageFeaturesTest, CropsAndHonoursTheStride) {
  const std::vector<std::uint8_t> bytes = {1, 2, 3, 99, 4, 5, 6, 99, 7, 8, 9, 99};
  ImageFeaturesOptions options = Grey(3, 3);
  options.crop_x = 1;
  options.crop_y = 1;
  options.crop_width = 2;
  EXPECT_THAT(Features(options, {bytes.data(), 3, 3, 1, 4}),
              ElementsAre(FloatEq(5.0F), FloatEq(6.0F), FloatEq(8.0F), FloatEq(9.0F)));
}

TEST(ImageFeaturesTest, GreyDependsOnTheOrderOfChannels) {
  const std::vector<std::uint8_t> bytes = {200, 100, 0};
  ImageFeaturesOptions options{.width = 1, .height = 1};
  options.light = LightNormalisation::kNone;
  options.grey = true;
  EXPECT_THAT(Features(options, View(bytes, 1, 3)), ElementsAre(FloatNear(118.5F, 1e-3F)));
  options.order = ChannelOrder::kBgr;
  EXPECT_THAT(Features(options, View(bytes, 1, 3)), ElementsAre(FloatNear(81.5F, 1e-3F)));
  options.grey = false;
  EXPECT_THAT(Features(options, View(bytes, 1, 3)),
              ElementsAre(FloatEq(200.0F), FloatEq(100.0F), FloatEq(0.0F)));
}

TEST(ImageFeaturesTest, LightNormalisationRemovesGainAndOffset) {
  core::Random random(1);
  std::vector<std::uint8_t> dim(64);
  for (auto& byte : dim) byte = static_cast<std::uint8_t>(20 + random.Below(50));
  std::vector<std::uint8_t> bright(64);
  std::vector<std::uint8_t> shifted(64);
  for (std::size_t i = 0; i < 64; ++i) {
    bright[i] = static_cast<std::uint8_t>(3 * dim[i]);
    shifted[i] = static_cast<std::uint8_t>(2 * dim[i] + 30);
  }
  ImageFeaturesOptions options = Grey(8, 8);
  options.light = LightNormalisation::kGain;
  EXPECT_THAT(Features(options, View(bright, 8, 1)),
              Pointwise(FloatNear(1e-3F), Features(options, View(dim, 8, 1))));
  options.light = LightNormalisation::kGainAndOffset;
  EXPECT_THAT(Features(options, View(shifted, 8, 1)),
              Pointwise(FloatNear(1e-3F), Features(options, View(dim, 8, 1))));
}

TEST(ImageFeaturesTest, BadPicturesAreNamedAndGiveNaN) {
  ImageFeaturesOptions options = Grey(4, 4);
  options.frozen_after = 3;
  ImageFeatures features(options);
  std::vector<float> out(16);
  std::vector<std::uint8_t> bytes(48, 50);
  const PictureView good{bytes.data(), 4, 4, 1, 4};
  const auto refused = [&](const PictureView& view, PictureFault reason) {
    out.assign(16, 0.0F);
    EXPECT_EQ(features.Apply(view, out), reason);
    EXPECT_THAT(out, Each(IsNan()));
  };
  refused({bytes.data(), 4, 3, 1, 4}, PictureFault::kWrongSize);
  refused({bytes.data(), 4, 4, 3, 12}, PictureFault::kWrongSize);
  refused({bytes.data(), 4, 4, 1, 3}, PictureFault::kWrongSize);
  refused({nullptr, 4, 4, 1, 4}, PictureFault::kWrongSize);
  EXPECT_EQ(features.Apply(good, out), PictureFault::kNone);
  EXPECT_EQ(features.Apply(good, out), PictureFault::kNone);
  refused(good, PictureFault::kFrozen);
  refused(good, PictureFault::kFrozen);
  bytes[15] = 51;
  EXPECT_EQ(features.Apply(good, out), PictureFault::kNone);
  EXPECT_EQ(features.Apply(good, out), PictureFault::kNone);
  features.Reset();
  EXPECT_EQ(features.Apply(good, out), PictureFault::kNone);
  bytes.assign(48, 1);
  refused(good, PictureFault::kDark);
  std::vector<float> few(15);
  EXPECT_EQ(features.Apply(good, few), PictureFault::kWrongSize);
}

TEST(ImageFeaturesTest, ApplyAllocatesNothing) {
  ImageFeaturesOptions options{.width = 9, .height = 7};
  options.out_width = 4;
  options.out_height = 3;
  options.light = LightNormalisation::kGainAndOffset;
  options.frozen_after = 2;
  ImageFeatures features(options);
  std::vector<std::uint8_t> bytes(9 * 7 * 3, 80);
  std::vector<float> out(static_cast<std::size_t>(features.size()));
  const test::NoAlloc guard;
  EXPECT_EQ(features.Apply(View(bytes, 9, 3), out), PictureFault::kNone);
}

TEST(ImageFeaturesTest, SpreadIsTheTransposeOfTheAverages) {
  core::Random random(4);
  for (const bool grey : {false, true}) {
    ImageFeaturesOptions options{.width = 9, .height = 7, .crop_x = 1, .crop_height = 5};
    options.out_width = 3;
    options.out_height = 2;
    options.grey = grey;
    options.light = LightNormalisation::kNone;
    std::vector<std::uint8_t> bytes(9 * 7 * 3);
    for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random.Below(256));
    const std::vector<float> features = Features(options, View(bytes, 9, 3));
    std::vector<double> shares(features.size());
    for (double& share : shares) share = random.Normal();
    std::vector<double> pixels(bytes.size(), 0.0);
    ImageFeatures(options).Spread(shares, pixels);
    double by_features = 0.0;
    double sum = 0.0;
    for (std::size_t i = 0; i < shares.size(); ++i) {
      by_features += shares[i] * static_cast<double>(features[i]);
      sum += shares[i];
    }
    double by_pixels = 0.0;
    for (std::size_t i = 0; i < pixels.size(); ++i) {
      by_pixels += pixels[i] * static_cast<double>(bytes[i]);
      sum -= pixels[i];
    }
    EXPECT_NEAR(by_pixels, by_features, 1e-3);
    EXPECT_NEAR(sum, 0.0, 1e-5);
  }
}

TEST(ImageFeaturesTest, OptionsOutOfRangeAreNamed) {
  const auto message = [](const ImageFeaturesOptions& options) {
    return test::MessageOf([&] { ImageFeatures features(options); });
  };
  EXPECT_THAT(message({}), HasSubstr("width and height must lie in [1, 8192], not 0 and 0"));
  EXPECT_THAT(message({.width = 4, .height = 4, .channels = 4}), HasSubstr("1 or 3, not 4"));
  ImageFeaturesOptions options = Grey(4, 4);
  options.crop_x = 2;
  options.crop_width = 3;
  EXPECT_THAT(message(options), HasSubstr("crop_x, crop_width: the part from 2 of size 3"));
  options = Grey(4, 4);
  options.out_height = 5;
  EXPECT_THAT(message(options), HasSubstr("[1, 4] and [1, 4], not 4 and 5"));
  options = Grey(4, 4);
  options.frozen_after = 1;
  EXPECT_THAT(message(options), HasSubstr("frozen_after must be 0 or at least 2, not 1"));
  options = Grey(4, 4);
  options.least_mean = 256.0;
  EXPECT_THAT(message(options), HasSubstr("least_mean must lie in [0, 255], not 256"));
}

}  // namespace
}  // namespace dfr::reduction
