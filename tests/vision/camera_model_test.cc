#include "dfr/vision/camera_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <initializer_list>
#include <limits>

#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::vision {
namespace {

using test::AllClose;

CameraModel Endoscope() {
  CameraModel camera;
  camera.fx = 702.0;
  camera.fy = 699.0;
  camera.cx = 322.5;
  camera.cy = 236.0;
  camera.distortion = {-0.18, 0.05, 8e-4, -6e-4, 0.01};
  return camera;
}

// Computed by hand with OpenCV's formula at (x/z, y/z) = (0.3, -0.2): r2 = 0.13.
TEST(CameraModelTest, ProjectsByTheDefinition) {
  const CameraModel camera = Endoscope();
  const double radial = 1 - 0.18 * 0.13 + 0.05 * 0.13 * 0.13 + 0.01 * 0.13 * 0.13 * 0.13;
  const double x = 0.3 * radial + 2 * 8e-4 * 0.3 * -0.2 - 6e-4 * (0.13 + 2 * 0.09);
  const double y = -0.2 * radial + 8e-4 * (0.13 + 2 * 0.04) + 2 * -6e-4 * 0.3 * -0.2;
  const Eigen::Vector2d expected(702.0 * x + 322.5, 699.0 * y + 236.0);
  EXPECT_TRUE(AllClose(camera.Project({0.03, -0.02, 0.1}), expected, 1e-10));
}

TEST(CameraModelTest, UndistortionInvertsDistortionOverTheWholeImage) {
  const CameraModel camera = Endoscope();
  for (int y = 0; y < camera.height; y += 13) {
    for (int x = 0; x < camera.width; x += 13) {
      const Eigen::Vector2d pixel(x, y);
      // Newton's last step is below 1e-10 in normalised coordinates, which is 7e-8 pixels.
      EXPECT_TRUE(AllClose(camera.ToPixel(camera.ToNormalized(pixel)), pixel, 1e-7));
    }
  }
}

TEST(CameraModelTest, ImpossiblePointsAreNaN) {
  CameraModel camera = Endoscope();
  EXPECT_TRUE(camera.Project({0.0, 0.0, -0.1}).array().isNaN().all());
  EXPECT_TRUE(camera.ToNormalized({std::nan(""), 0.0}).array().isNaN().all());
  // This lens folds over at r = 0.41: no ray reaches the pixel.
  camera.distortion = {-2.0, 0.0, 0.0, 0.0, 0.0};
  EXPECT_TRUE(camera.ToNormalized({1.0, 1.0}).array().isNaN().all());
}

TEST(CameraModelTest, InvalidParametersAreRefused) {
  using Change = void (*)(CameraModel&);
  for (const Change change : std::initializer_list<Change>{
           [](auto& c) { c.fy = -1.0; }, [](auto& c) { c.width = 0; },
           [](auto& c) { c.distortion[2] = std::numeric_limits<double>::infinity(); }}) {
    CameraModel camera = Endoscope();
    change(camera);
    EXPECT_THROW(camera.Check(), std::invalid_argument);
  }
}

TEST(CameraModelTest, NeverAllocates) {
  const CameraModel camera = Endoscope();
  const test::NoAlloc guard;
  EXPECT_TRUE(camera.ToNormalized({10.0, 20.0}).allFinite());
}

}  // namespace
}  // namespace dfr::vision
