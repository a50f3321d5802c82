#include "dfr/sim/line_tracking/line_tracking_plant.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <thread>
#include <vector>

#include "tests/sim_line_tracking/perfect_calibration.h"
#include "tests/support/no_alloc.h"

namespace dfr::sim {
namespace {

using core::PlantStatus;
using test::Apply;
using test::Observe;
using test::PerfectCalibration;
using test::State;

LineTrackingOptions Truth(Wave wave = Wave::kNone) {
  LineTrackingOptions options;
  options.observation = Observation::kGroundTruth;
  options.disturbance.wave = wave;
  return options;
}

TEST(LineTrackingPlantTest, OpenLoopDemonstrationsFollowTheLineWhenNothingMoves) {
  const line_task::LineCalibration known = PerfectCalibration(Truth());
  LineTrackingPlant plant(Truth(), &known);
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    SCOPED_TRACE(seed);
    plant.Reset(seed);
    ASSERT_FALSE(plant.completed());
    const core::Matrix controls = plant.OpenLoopControls(50, 1e-3);
    double farthest = 0.0;
    for (int i = 0; i < controls.rows(); ++i) {
      ASSERT_EQ(plant.Apply(core::Row(controls, i)), PlantStatus::kOk);
      farthest = std::max(farthest, std::abs(plant.truth().distance_m));
    }
    EXPECT_TRUE(plant.completed());
    // The initial error of 0.6 mm (standard deviation), and the residual that no calibration can
    // remove.
    EXPECT_LT(farthest, LineTrackingPlant::kCollision);
    // The mean of this residual is 0.5 mm, and it occurs at both ends.
    EXPECT_NEAR(plant.truth().progress_m, 0.050, 2.5e-3);
  }
}

TEST(LineTrackingPlantTest, StateIsInMillimetresAndDistanceIsPositiveToTheLeft) {
  LineTrackingPlant plant(Truth());
  plant.Reset(1);
  const State before = Observe(plant);
  ASSERT_EQ(Apply(plant, 0.0, 0.5), PlantStatus::kOk);  // 1 mm to +y
  const State after = Observe(plant);
  // The arm's scale errors are a few per cent.
  EXPECT_NEAR(after[1] - before[1], 1.0, 0.15);
  EXPECT_NEAR(after[0] - before[0], 0.0, 0.15);
  EXPECT_NEAR(after[2] - before[2], 1.0, 0.15);
  EXPECT_NEAR(after[2], 1e3 * plant.truth().distance_m, 1e-12);
  EXPECT_NEAR(after[3], 10.0 * plant.truth().heading_rad, 1e-12);
}

TEST(LineTrackingPlantTest, CollidesBeyondFourMillimetresAndStaysCollided) {
  LineTrackingPlant plant(Truth());
  plant.Reset(2);
  while (std::abs(plant.truth().distance_m) < 0.0037) {
    ASSERT_FALSE(plant.collided());
    ASSERT_EQ(Apply(plant, 0.0, 0.1), PlantStatus::kOk);
  }
  EXPECT_FALSE(plant.collided());
  ASSERT_EQ(Apply(plant, 0.0, 0.5), PlantStatus::kOk);
  EXPECT_GT(std::abs(plant.truth().distance_m), LineTrackingPlant::kCollision);
  EXPECT_TRUE(plant.collided());
  for (int i = 0; i < 5; ++i) ASSERT_EQ(Apply(plant, 0.0, -0.4), PlantStatus::kOk);
  EXPECT_LT(std::abs(plant.truth().distance_m), 0.003);
  EXPECT_TRUE(plant.collided());
  plant.Reset(2);
  EXPECT_FALSE(plant.collided());
}

TEST(LineTrackingPlantTest, ControlsSaturateAndBadOnesAreRefused) {
  LineTrackingPlant plant(Truth());
  plant.Reset(3);
  const State x = Observe(plant);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(Apply(plant, nan, 0.0), PlantStatus::kRefused);
  EXPECT_EQ(plant.Apply(std::array{0.1}), PlantStatus::kRefused);
  EXPECT_EQ(Observe(plant), x);

  const auto copy = plant.Clone();
  ASSERT_EQ(Apply(plant, 7.0, 0.0), PlantStatus::kOk);
  ASSERT_EQ(Apply(*copy, 1.0, 0.0), PlantStatus::kOk);
  EXPECT_EQ(Observe(plant), Observe(*copy));
}

TEST(LineTrackingPlantTest, ControlsBeyondTheArmsReachAreRefused) {
  LineTrackingPlant plant(Truth());
  plant.Reset(4);
  PlantStatus status = PlantStatus::kOk;
  for (int i = 0; i < 500 && status == PlantStatus::kOk; ++i) status = Apply(plant, 1.0, 0.0);
  ASSERT_EQ(status, PlantStatus::kRefused);
  const State x = Observe(plant);
  EXPECT_EQ(Apply(plant, 1.0, 0.0), PlantStatus::kRefused);
  EXPECT_EQ(Observe(plant), x);
  EXPECT_EQ(Apply(plant, -1.0, 0.0), PlantStatus::kOk);
  EXPECT_FALSE(plant.MoveTip({0.0, 0.0, 1.0}));
  EXPECT_FALSE(plant.MoveTip({std::nan(""), 0.0, 0.0}));
}

// If the disturbance acts during controls, time passes with travel. If it acts between controls,
// time passes with their number.
TEST(LineTrackingPlantTest, DisturbanceActsWhenItWasAskedTo) {
  const auto gauze_moves = [](bool during, bool between, double u) {
    LineTrackingOptions options = Truth(Wave::kSine);
    options.disturbance.during = during;
    options.disturbance.between = between;
    LineTrackingPlant plant(options);
    plant.Reset(5);
    const Eigen::Vector3d before = plant.truth().p_world_gauze.translation();
    for (int i = 0; i < 10; ++i) EXPECT_EQ(Apply(plant, u, 0.0), PlantStatus::kOk);
    return (plant.truth().p_world_gauze.translation() - before).norm();
  };
  EXPECT_EQ(gauze_moves(false, false, 0.5), 0.0);
  EXPECT_EQ(gauze_moves(true, false, 0.0), 0.0);  // without travel, no time passes
  EXPECT_GT(gauze_moves(true, false, 0.5), 1e-3);
  EXPECT_GT(gauze_moves(false, true, 0.0), 1e-3);
  EXPECT_LT(gauze_moves(true, false, 0.001), 1e-4);
}

TEST(LineTrackingPlantTest, DisturbanceStopsWithHalt) {
  LineTrackingPlant plant(Truth(Wave::kRandom));
  plant.Reset(6);
  for (int i = 0; i < 10; ++i) ASSERT_EQ(Apply(plant, 0.5, 0.0), PlantStatus::kOk);
  plant.Halt();
  const Eigen::Vector3d before = plant.truth().p_world_gauze.translation();
  ASSERT_EQ(Apply(plant, 0.5, 0.0), PlantStatus::kOk);
  EXPECT_EQ(plant.truth().p_world_gauze.translation(), before);
}

// In a world in real time the platform moves while the robot observes and computes, after Halt(),
// and without any travel. It follows its command with a lag and does not jump to it.
TEST(LineTrackingPlantTest, RealTimeNeverStops) {
  LineTrackingOptions options = Truth(Wave::kSine);
  options.disturbance.real_time = true;
  const auto gauze_moves = [&](double latency_s, double u) {
    options.disturbance.latency_s = latency_s;
    LineTrackingPlant plant(options);
    plant.Reset(5);
    const Eigen::Vector3d before = plant.truth().p_world_gauze.translation();
    for (int i = 0; i < 10; ++i) EXPECT_EQ(Apply(plant, u, 0.0), PlantStatus::kOk);
    return (plant.truth().p_world_gauze.translation() - before).norm();
  };
  EXPECT_EQ(gauze_moves(0.0, 0.0), 0.0);
  const double slow = gauze_moves(0.03, 0.0);
  EXPECT_GT(slow, 1e-4);
  EXPECT_GT(gauze_moves(0.06, 0.0), slow);
  EXPECT_GT(gauze_moves(0.0, 0.5), 1e-3);

  LineTrackingPlant plant(options);
  plant.Reset(5);
  ASSERT_EQ(Apply(plant, 0.5, 0.0), PlantStatus::kOk);
  plant.Halt();
  const Eigen::Vector3d tip = plant.truth().tip_m;
  const Eigen::Vector3d gauze = plant.truth().p_world_gauze.translation();
  const test::NoAlloc guard;
  plant.Hold(5.0);
  EXPECT_LT((plant.truth().tip_m - tip).norm(), 1e-4);  // the joints drift slightly with time
  EXPECT_GT((plant.truth().p_world_gauze.translation() - gauze).norm(), 5e-3);
}

// Uses the caller's arm and clock, with the readings of Apply().
TEST(LineTrackingPlantTest, DrivenByReadingsItDoesWhatItDoesByControls) {
  LineTrackingOptions options = Truth(Wave::kRandom);
  options.disturbance.between = true;
  for (const bool during : {true, false}) {
    options.disturbance.during = during;
    LineTrackingPlant plant(options);
    plant.Reset(7);
    const auto copy = plant.Clone();
    auto& driven = static_cast<LineTrackingPlant&>(*copy);
    for (int i = 0; i < 40; ++i) {
      const std::array<double, 2> u = {0.5 + 0.4 * std::sin(i), 0.5 * std::cos(3.0 * i)};
      const kinematics::PsmJoints from = driven.reported_joints();
      ASSERT_EQ(plant.Apply(u), PlantStatus::kOk);
      const kinematics::PsmJoints to = plant.reported_joints();
      const Eigen::Vector3d step(LineTrackingPlant::kStep * u[0], LineTrackingPlant::kStep * u[1],
                                 0.0);
      const double duration_s = step.norm() / LineTrackingPlant::kSpeed;
      const int samples = static_cast<int>(std::ceil(duration_s / 0.02));
      const double dt_s = duration_s / samples;
      const test::NoAlloc guard;
      for (int k = 1; k <= samples; ++k) {
        const kinematics::PsmJoints target =
            from + (to - from) * (static_cast<double>(k) / samples);
        const kinematics::PsmJoints now = driven.reported_joints();
        driven.Drive(now + (1.0 - std::exp(-dt_s / 0.02)) * (target - now), dt_s, during);
      }
      driven.Rest(to);
    }
    EXPECT_EQ(driven.TrueState(), plant.TrueState());
    EXPECT_EQ(driven.collided(), plant.collided());
    EXPECT_EQ(driven.platform_pose().translation_m, plant.platform_pose().translation_m);
  }
}

// Without further motion, a platform settles at its commanded pose with its time constant.
TEST(LineTrackingPlantTest, DrivenPlatformLagsBehindItsCommand) {
  LineTrackingPlant plant(Truth(Wave::kRandom));
  plant.Reset(7);
  const kinematics::PsmJoints reading = plant.reported_joints();
  for (int i = 0; i < 500; ++i) plant.Drive(reading, 2e-3, true);
  const Eigen::Vector3d there = plant.platform_setpoint().translation_m;
  const double behind = (plant.platform_pose().translation_m - there).norm();
  ASSERT_GT(behind, 2e-5);
  for (int i = 0; i < 100; ++i) plant.Drive(reading, 2e-3, false);
  EXPECT_EQ(plant.platform_setpoint().translation_m, there);
  EXPECT_NEAR((plant.platform_pose().translation_m - there).norm(), std::exp(-1.0) * behind, 1e-12);
  plant.Rest(reading);
  EXPECT_EQ(plant.platform_pose().translation_m, there);
}

TEST(LineTrackingPlantTest, PicturesCountedByOthersAreThoseThatLookTakes) {
  LineTrackingPlant plant;
  plant.Reset(8);  // uses up the first value
  plant.Look();
  std::vector<std::uint8_t> second(plant.endoscope().image_size());
  plant.RenderEndoscope(second);
  std::vector<std::uint8_t> counted(second.size());
  LineTrackingPlant other(Truth());  // takes none
  other.Reset(8);
  other.RenderPicture(2, counted);
  EXPECT_EQ(counted, second);
  other.RenderPicture(3, counted);
  EXPECT_NE(counted, second);
}

TEST(LineTrackingPlantTest, CloneContinuesBitForBitAndSeedsDecideEverything) {
  for (const Observation observation : {Observation::kGroundTruth, Observation::kVision}) {
    LineTrackingOptions options = Truth(Wave::kRandom);
    options.observation = observation;
    options.disturbance.between = true;
    LineTrackingPlant plant(options);
    const auto copy = plant.Clone();
    auto& same = static_cast<LineTrackingPlant&>(*copy);
    plant.Reset(7);
    same.Reset(8);
    EXPECT_NE(Observe(plant), Observe(same));
    same.Reset(7);
    EXPECT_EQ(Observe(plant), Observe(same));
    for (int i = 0; i < 3; ++i) ASSERT_EQ(Apply(plant, 0.5, 0.05 * i), PlantStatus::kOk);
    const auto clone = plant.Clone();
    same.CopyStateFrom(plant);
    EXPECT_EQ(Observe(plant), Observe(*clone));
    for (int i = 0; i < 2; ++i) {
      ASSERT_EQ(Apply(plant, 0.4, -0.1), PlantStatus::kOk);
      ASSERT_EQ(Apply(*clone, 0.4, -0.1), PlantStatus::kOk);
      ASSERT_EQ(Apply(same, 0.4, -0.1), PlantStatus::kOk);
      EXPECT_EQ(Observe(plant), Observe(*clone));
      EXPECT_EQ(Observe(plant), Observe(same));
    }
  }
}

TEST(LineTrackingPlantTest, GroundTruthControlsNeverAllocate) {
  LineTrackingPlant plant(Truth(Wave::kRandom));
  plant.Reset(9);
  const auto clone = plant.Clone();
  const test::NoAlloc guard;
  for (int i = 0; i < 20; ++i) {
    ASSERT_EQ(Apply(plant, 0.5, 0.1), PlantStatus::kOk);
    static_cast<void>(plant.completed());
  }
  clone->CopyStateFrom(plant);
  plant.Halt();
}

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
TEST(LineTrackingPlantTest, ThePictureShowsMarksWhereTheCameraProjectsThem) {
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
      // A disc with a radius of 11 pixels, drawn in whole pixels. Each of its 70 rim pixels has a
      // uniform error of up to a half, which gives the centre a standard deviation of 0.06; the
      // limit is three of these.
      EXPECT_LT(error.norm(), 0.2) << mark.transpose();
      mean += error / 16.0;
    }
  }
  // The mean of 16 such centres has a standard deviation of 0.02. A wrong convention would shift it
  // by half a pixel.
  EXPECT_LT(mean.norm(), 0.06);
}

// Each thread draws in a separate OpenGL context; pictures and states have the same bits.
TEST(LineTrackingPlantTest, ImagesDoNotDependOnTheThread) {
  LineTrackingOptions options;
  options.disturbance.wave = Wave::kRandom;
  const auto run = [&options](std::vector<State>& states) {
    LineTrackingPlant plant(options);
    LineTrackingPlant other(options);  // draws alternately on the same thread
    plant.Reset(3);
    other.Reset(4);
    for (int i = 0; i < 2; ++i) {
      ASSERT_EQ(Apply(plant, 0.5, 0.1), PlantStatus::kOk);
      ASSERT_EQ(Apply(other, 0.5, -0.1), PlantStatus::kOk);
      states.push_back(Observe(plant));
    }
  };
  std::array<std::vector<State>, 2> states;
  std::thread thread([&] { run(states[0]); });
  run(states[1]);
  thread.join();
  EXPECT_EQ(states[0], states[1]);
  EXPECT_TRUE(std::isfinite(states[0].back()[2]));
}

TEST(LineTrackingPlantTest, TheOutsideViewShowsTheArmMove) {
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
TEST(LineTrackingPlantTest, VisionFindsTheTipAndItsSideOfTheLine) {
  LineTrackingOptions options;
  options.disturbance.wave = Wave::kRandom;
  options.endoscope.blur_px = 2.0;
  options.endoscope.light_change = 0.5;
  options.endoscope.glare = 60.0;
  const line_task::LineCalibration known = PerfectCalibration(options);
  LineTrackingPlant plant(options, &known);
  plant.Reset(0);
  for (int i = 0; i < 6; ++i) {
    ASSERT_EQ(Apply(plant, 0.4, i < 3 ? 0.3 : -0.3), PlantStatus::kOk);
    const vision::LineObservation& seen = plant.last_observation();
    ASSERT_TRUE(seen.seen()) << vision::Name(seen.missing);
    const LineTrackingTruth truth = plant.truth();
    const State x = Observe(plant);
    EXPECT_NEAR(seen.distance_m, truth.distance_m, 3e-4);
    EXPECT_LT(std::hypot(1e-3 * x[0] - truth.tip_m.x(), 1e-3 * x[1] - truth.tip_m.y()), 3e-4);
  }
}

// Each case ends in a NaN state, at which controllers halt.
TEST(LineTrackingPlantTest, AStateThatTheImageDoesNotShowIsNaN) {
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

  // The tip is really outside the picture.
  plant.Reset(12);
  ASSERT_TRUE(plant.MoveTip({0.075, 0.0, 0.003}));
  plant.Look();
  EXPECT_FALSE(plant.last_observation().seen());
}

TEST(LineTrackingPlantTest, IntrinsicsOfAnotherCameraAreNoticed) {
  const auto missing = [](auto change) {
    const LineTrackingOptions options;
    line_task::LineCalibration known = PerfectCalibration(options);
    change(known.camera);
    LineTrackingPlant plant(options, &known);
    plant.Reset(1);
    return plant.last_observation().missing;
  };
  EXPECT_NE(missing([](auto& camera) { camera.fx = camera.fy = 1000.0; }),
            vision::NotSeen::kNothing);
  EXPECT_NE(missing([](auto& camera) {
              camera.distortion = {0.2, 0.0, 0.0, 0.0, 0.0};
            }),
            vision::NotSeen::kNothing);
  EXPECT_EQ(missing([](auto& camera) { camera.width = 1280; }), vision::NotSeen::kWrongSize);
}

TEST(LineTrackingPlantTest, BadOptionsThrow) {
  using Change = void (*)(LineTrackingOptions&);
  for (const Change change : std::initializer_list<Change>{
           [](auto& o) { o.endoscope.light_change = 2.0; },
           [](auto& o) { o.endoscope.blur_px = -1.0; }, [](auto& o) { o.max_curvature = 1.0; },
           [](auto& o) { o.start_scatter_m = -1.0; }, [](auto& o) { o.disturbance.pause_s = -1.0; },
           [](auto& o) {
             o = Truth(Wave::kSine);
             o.disturbance.amplitude[2] = 0.02;  // beyond the platform's reach
           }}) {
    LineTrackingOptions options = Truth();
    change(options);
    EXPECT_THROW(LineTrackingPlant{options}, std::invalid_argument);
  }
  LineTrackingPlant plant(Truth());
  EXPECT_THROW(static_cast<void>(plant.OpenLoopControls(0, 1e-3)), std::invalid_argument);
  kinematics::PlatformPose pose;
  pose.angles_rad.y() = 0.26;
  EXPECT_THROW(plant.MovePlatform(pose), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::sim
