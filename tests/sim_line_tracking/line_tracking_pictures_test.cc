#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "dfr/sim/line_tracking/line_tracking_plant.h"
#include "tests/sim_line_tracking/perfect_calibration.h"

// The pictures of a plant, and the features that vision detects in them.
namespace dfr::sim {
namespace {

using core::PlantStatus;
using test::Apply;
using test::Observe;
using test::PerfectCalibration;
using test::State;
using test::Truth;

// Returns the centre of the blue pixels near a pixel, weighted by their blueness.
Eigen::Vector2d BlueCentre(const std::vector<std::uint8_t>& bgr, const Eigen::Vector2d& near) {
  constexpr int kRadius = 18;
  double sum = 0.0;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();
  for (int y = static_cast<int>(near.y()) - kRadius; y <= static_cast<int>(near.y()) + kRadius;
       ++y) {
    for (int x = static_cast<int>(near.x()) - kRadius; x <= static_cast<int>(near.x()) + kRadius;
         ++x) {
      const auto i =
          std::size_t{3} * (static_cast<std::size_t>(y) * 640 + static_cast<std::size_t>(x));
      const double blue = std::max(0.0, static_cast<double>(bgr[i]) - bgr[i + 2] - 15.0);
      sum += blue;
      centre += blue * Eigen::Vector2d(x, y);
    }
  }
  return centre / sum;
}

// MuJoCo's camera with the lens, and the camera model, give the same pixel.
TEST(LineTrackingPicturesTest, ThePictureShowsMarksWhereTheCameraProjectsThem) {
  LineTrackingOptions options = Truth();
  options.endoscope = {.light_change = 0.0, .glare = 0.0, .blur_px = 0.0, .noise = 0.0};
  LineTrackingPlant plant(options);
  plant.Reset(1);
  ASSERT_TRUE(plant.MoveTip({0.02, 0.005, 0.004}));  // the shaft covers no mark
  kinematics::PlatformPose tilted;
  tilted.translation_m = {0.002, -0.003, -0.004};
  tilted.angles_rad = {0.03, -0.02, 0.05};
  std::vector<std::uint8_t> bgr(plant.endoscope().image_size());
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const kinematics::PlatformPose& pose : {kinematics::PlatformPose(), tilted}) {
    plant.MovePlatform(pose);
    plant.RenderEndoscope(bgr);
    const Eigen::Isometry3d p_cam_gauze =
        LineTrackingPlant::p_world_cam().inverse() * plant.truth().p_world_gauze;
    for (const Eigen::Vector2d& mark : LineTrackingPlant::target().marks_m) {
      const Eigen::Vector2d pixel = LineTrackingPlant::true_camera().Project(
          p_cam_gauze * Eigen::Vector3d(mark.x(), mark.y(), 0.0));
      const Eigen::Vector2d error = BlueCentre(bgr, pixel) - pixel;
      // A disc has a radius of 11 pixels and is drawn in whole pixels. Each of its 70 rim pixels
      // has a uniform error of up to a half, which gives the centre a standard deviation of 0.06.
      // The limit is three standard deviations.
      EXPECT_LT(error.norm(), 0.2) << mark.transpose();
      mean += error / 16.0;
    }
  }
  // The mean of 16 such centres has a standard deviation of 0.02. A wrong convention would shift it
  // by half a pixel.
  EXPECT_LT(mean.norm(), 0.06);
}

TEST(LineTrackingPicturesTest, TheOutsideViewShowsTheArmMove) {
  LineTrackingPlant plant(Truth());
  plant.Reset(1);
  std::vector<std::uint8_t> one(std::size_t{3} * 640 * 480);
  std::vector<std::uint8_t> other(one.size());
  plant.RenderOutside(one);
  plant.RenderOutside(other);
  EXPECT_EQ(one, other);
  for (int i = 0; i < 5; ++i) ASSERT_EQ(Apply(plant, 1.0, 0.0), PlantStatus::kOk);
  plant.RenderOutside(other);
  EXPECT_NE(one, other);
}

// The system tier tests the requirement on vision over hundreds of pictures.
TEST(LineTrackingPicturesTest, VisionFindsTheTipAndItsSideOfTheLine) {
  LineTrackingOptions options;
  options.disturbance.wave = Wave::kRandom;
  options.endoscope.blur_px = 2.0;
  options.endoscope.light_change = 0.5;
  options.endoscope.glare = 60.0;
  const line_task::LineCalibration known = PerfectCalibration(options);
  LineTrackingPlant plant(options, &known);
  plant.Reset(0);
  for (int i = 0; i < 4; ++i) {
    ASSERT_EQ(Apply(plant, 0.4, i < 2 ? 0.3 : -0.3), PlantStatus::kOk);
    const vision::LineObservation& seen = plant.last_observation();
    ASSERT_TRUE(seen.seen()) << vision::Name(seen.missing);
    const LineTrackingTruth truth = plant.truth();
    const State x = Observe(plant);
    EXPECT_NEAR(seen.distance_m, truth.distance_m, 3e-4);
    EXPECT_LT(std::hypot(1e-3 * x[0] - truth.tip_m.x(), 1e-3 * x[1] - truth.tip_m.y()), 3e-4);
  }
}

// Each case ends in a NaN state, at which controllers halt.
TEST(LineTrackingPicturesTest, AStateThatTheImageDoesNotShowIsNaN) {
  LineTrackingPlant plant;
  const auto reason = [&plant](CameraFault fault) {
    plant.Reset(11);
    EXPECT_TRUE(plant.last_observation().seen());
    plant.SetCameraFault(fault);
    EXPECT_EQ(Apply(plant, 0.5, 0.0), PlantStatus::kOk);
    for (double entry : Observe(plant)) EXPECT_TRUE(std::isnan(entry));
    return plant.last_observation().missing;
  };
  EXPECT_EQ(reason(CameraFault::kFrozen), vision::NotSeen::kFrozen);
  EXPECT_EQ(reason(CameraFault::kBlack), vision::NotSeen::kDark);
  EXPECT_EQ(reason(CameraFault::kOverexposed), vision::NotSeen::kOverexposed);
  EXPECT_EQ(reason(CameraFault::kNoLine), vision::NotSeen::kLine);
  EXPECT_EQ(reason(CameraFault::kNoTip), vision::NotSeen::kTip);

  // The true tip is outside the picture.
  plant.Reset(12);
  ASSERT_TRUE(plant.MoveTip({0.075, 0.0, 0.003}));
  plant.Look();
  EXPECT_FALSE(plant.last_observation().seen());
}

TEST(LineTrackingPicturesTest, RenderPictureDrawsThePictureOfThatLook) {
  LineTrackingPlant plant;
  plant.Reset(8);  // takes picture 1
  plant.Look();
  std::vector<std::uint8_t> second(plant.endoscope().image_size());
  plant.RenderEndoscope(second);
  std::vector<std::uint8_t> counted(second.size());
  LineTrackingPlant other(Truth());  // takes no picture
  other.Reset(8);
  other.RenderPicture(2, counted);
  EXPECT_EQ(counted, second);
  other.RenderPicture(3, counted);
  EXPECT_NE(counted, second);
}

}  // namespace
}  // namespace dfr::sim
