#include "dfr/sim/line_tracking/endoscope.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "tests/support/no_alloc.h"

namespace dfr::sim {
namespace {

EndoscopeScene Scene() {
  static const std::vector<Eigen::Vector2d> kMarks = LineTrackingPlant::target().marks_m;
  EndoscopeScene scene;
  scene.p_cam_gauze = LineTrackingPlant::p_world_cam().inverse();
  scene.marks_m = &kMarks;
  scene.tool_cam = {Eigen::Vector3d(0.0, 0.0, -1.0), Eigen::Vector3d(0.0, 0.0, -1.0),
                    Eigen::Vector3d(0.0, 0.0, -1.0), Eigen::Vector3d(0.0, 0.0, -1.0)};  // none
  return scene;
}

// Centre of what is blue, weighted by how blue, within `radius` pixels.
Eigen::Vector2d BlueCentre(const Endoscope& endoscope, const std::vector<std::uint8_t>& bgr,
                           const Eigen::Vector2d& near, int radius) {
  double sum = 0.0;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  for (int y = static_cast<int>(near.y()) - radius; y <= static_cast<int>(near.y()) + radius; ++y) {
    for (int x = static_cast<int>(near.x()) - radius; x <= static_cast<int>(near.x()) + radius;
         ++x) {
      const auto i = static_cast<std::size_t>(3 * (y * endoscope.camera().width + x));
      const double blue = std::max(0.0, static_cast<double>(bgr[i]) - bgr[i + 2] - 15.0);
      sum += blue;
      centre += blue * Eigen::Vector2d(x, y);
    }
  }
  return centre / sum;
}

// The picture and the camera model are two ways to the same point, lens distortion included.
TEST(EndoscopeTest, DrawsMarksWhereTheCameraProjectsThem) {
  const Endoscope endoscope(LineTrackingPlant::true_camera());
  const EndoscopeScene scene = Scene();
  EndoscopeLight light;
  light.noise = 0.0;
  std::vector<std::uint8_t> bgr(endoscope.image_size());
  endoscope.Render(scene, light, 1, bgr.data());
  for (const Eigen::Vector2d& mark : *scene.marks_m) {
    const Eigen::Vector2d pixel =
        endoscope.camera().Project(scene.p_cam_gauze * Eigen::Vector3d(mark.x(), mark.y(), 0.0));
    // Perspective makes a circle's centre and the centre of its image differ by some 0.02 pixels;
    // eight bits and the brighter side of the light add as much.
    EXPECT_LT((BlueCentre(endoscope, bgr, pixel, 18) - pixel).norm(), 0.06);
  }
}

TEST(EndoscopeTest, SameSeedGivesTheSamePictureAndAnotherSeedOtherNoise) {
  const Endoscope endoscope(LineTrackingPlant::true_camera());
  std::vector<std::uint8_t> one(endoscope.image_size());
  std::vector<std::uint8_t> other(endoscope.image_size());
  endoscope.Render(Scene(), {}, 1, one.data());
  endoscope.Render(Scene(), {}, 1, other.data());
  EXPECT_EQ(one, other);
  endoscope.Render(Scene(), {}, 2, other.data());
  EXPECT_NE(one, other);
  double squared = 0.0;
  for (std::size_t i = 0; i < one.size(); ++i) {
    squared += std::pow(static_cast<double>(one[i]) - other[i], 2);
  }
  // Two pictures' noise of 3 levels each, clipped at black for the dark table around the gauze.
  EXPECT_NEAR(std::sqrt(squared / static_cast<double>(one.size())), 3.0 * std::sqrt(2.0), 0.3);
}

TEST(EndoscopeTest, RenderingNeverAllocates) {
  const Endoscope endoscope(LineTrackingPlant::true_camera());
  const EndoscopeScene scene = Scene();
  std::vector<std::uint8_t> bgr(endoscope.image_size());
  const test::NoAlloc guard;
  endoscope.Render(scene, {}, 1, bgr.data());
}

TEST(EndoscopeTest, ALensThatFoldsOverThrows) {
  vision::CameraModel camera = LineTrackingPlant::true_camera();
  camera.distortion = {-2.0, 0.0, 0.0, 0.0, 0.0};
  EXPECT_THROW(Endoscope{camera}, std::invalid_argument);
}

}  // namespace
}  // namespace dfr::sim
