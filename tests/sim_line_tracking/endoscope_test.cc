#include "dfr/sim/line_tracking/endoscope.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::sim {
namespace {

using Picture = std::vector<std::uint8_t>;

constexpr int kWidth = 640;
constexpr int kHeight = 480;

std::size_t At(int x, int y) {
  return std::size_t{3} * (static_cast<std::size_t>(y) * kWidth + static_cast<std::size_t>(x));
}

// Returns an even light without noise and blur.
EndoscopeLight Plain() {
  EndoscopeLight light;
  light.blur_px = 0.0;
  light.noise = 0.0;
  return light;
}

Picture Develop(const Endoscope& endoscope, const Picture& pinhole, const EndoscopeLight& light,
                std::uint64_t seed = 1) {
  Picture bgr(endoscope.image_size());
  endoscope.Develop(pinhole, light, seed, bgr);
  return bgr;
}

// Returns a soft white spot in a pinhole picture with the bottom row first. The centre is defined
// to a fraction of a pixel.
Picture PinholeSpot(const Eigen::Vector2d& ray, double fovy_rad) {
  const double focal = 0.5 * kHeight / std::tan(0.5 * fovy_rad);
  const double x0 = 0.5 * (kWidth - 1) + focal * ray.x();
  const double y0 = 0.5 * (kHeight - 1) + focal * ray.y();
  Picture rgb(3 * kWidth * kHeight, 0);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double r2 = (x - x0) * (x - x0) + (y - y0) * (y - y0);
      const auto value = static_cast<std::uint8_t>(std::lround(240.0 * std::exp(-r2 / 18.0)));
      for (std::size_t k = 0; k < 3; ++k) rgb[At(x, kHeight - 1 - y) + k] = value;
    }
  }
  return rgb;
}

Eigen::Vector2d Centre(const Picture& bgr) {
  double sum = 0.0;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      sum += bgr[At(x, y)];
      centre += bgr[At(x, y)] * Eigen::Vector2d(x, y);
    }
  }
  return centre / sum;
}

// The lens agrees with the camera model: each ray appears at the pixel of the model.
TEST(EndoscopeTest, DistortsLikeTheCameraModel) {
  const Endoscope endoscope(LineTrackingPlant::true_camera());
  for (const Eigen::Vector2d& ray : {Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(0.3, 0.1),
                                     Eigen::Vector2d(-0.38, 0.27), Eigen::Vector2d(0.1, -0.3)}) {
    const Picture bgr = Develop(endoscope, PinholeSpot(ray, endoscope.pinhole_fovy_rad()), Plain());
    const Eigen::Vector2d pixel = endoscope.camera().ToPixel(ray);
    // The lookup is accurate to 1/32 pixel. The varying magnification and the vignette's slope move
    // the spot's centre by a similar amount.
    EXPECT_LT((Centre(bgr) - pixel).norm(), 0.06) << ray.transpose();
  }
}

TEST(EndoscopeTest, CoversTheWholePictureInBgr) {
  const Endoscope endoscope(LineTrackingPlant::true_camera());
  Picture rgb(3 * kWidth * kHeight, 200);
  for (std::size_t i = 0; i < rgb.size(); i += 3) rgb[i] = 180;
  const Picture bgr = Develop(endoscope, rgb, Plain());
  // The vignette reduces all values, in the corners by 13 %.
  for (std::size_t i = 0; i < bgr.size(); ++i) ASSERT_GE(bgr[i], i % 3 == 2 ? 148 : 165);
  EXPECT_NEAR(bgr[At(322, 236)], 200, 1);
  EXPECT_NEAR(bgr[At(322, 236) + 1], 200, 1);
  EXPECT_NEAR(bgr[At(322, 236) + 2], 180, 1);
}

TEST(EndoscopeTest, SameSeedGivesTheSamePictureAndAnotherSeedOtherNoise) {
  const Endoscope endoscope(LineTrackingPlant::true_camera());
  const Picture grey(3 * kWidth * kHeight, 100);
  EndoscopeLight light = Plain();
  light.noise = 3.0;
  const Picture one = Develop(endoscope, grey, light, 1);
  EXPECT_EQ(one, Develop(endoscope, grey, light, 1));
  const Picture other = Develop(endoscope, grey, light, 2);
  double squared = 0.0;
  for (std::size_t i = 0; i < one.size(); ++i) {
    squared += std::pow(static_cast<double>(one[i]) - other[i], 2);
  }
  // The noise is 3 levels in each of two pictures, plus the rounding of both, 1/12 of a squared
  // level each. With 921600 samples the estimate is accurate to a thousandth.
  EXPECT_NEAR(std::sqrt(squared / static_cast<double>(one.size())), std::sqrt(18.0 + 2.0 / 12.0),
              0.02);
}

TEST(EndoscopeTest, BlurKeepsTheLightAndSpreadsIt) {
  const Endoscope endoscope(LineTrackingPlant::true_camera());
  const Picture spot = PinholeSpot({0.05, 0.05}, endoscope.pinhole_fovy_rad());
  EndoscopeLight light = Plain();
  const Picture sharp = Develop(endoscope, spot, light);
  light.blur_px = 2.0;
  const Picture blurred = Develop(endoscope, spot, light);
  EXPECT_LT((Centre(blurred) - Centre(sharp)).norm(), 0.05);  // rounding to 8 bits
  EXPECT_LT(*std::max_element(blurred.begin(), blurred.end()),
            *std::max_element(sharp.begin(), sharp.end()) - 50);
}

TEST(EndoscopeTest, ALensThatFoldsOverThrows) {
  vision::CameraModel camera = LineTrackingPlant::true_camera();
  camera.distortion = {-2.0, 0.0, 0.0, 0.0, 0.0};
  EXPECT_THROW(Endoscope{camera}, std::invalid_argument);
}

}  // namespace
}  // namespace dfr::sim
