#include "dfr/sim/line_tracking/line_tracking_plant.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "tests/sim_line_tracking/perfect_calibration.h"
#include "tests/support/no_alloc.h"

namespace dfr::sim {
namespace {

using core::PlantStatus;
using test::Apply;
using test::Observe;
using test::PerfectCalibration;
using test::State;
using test::Truth;

TEST(LineTrackingPlantTest, OpenLoopDemonstrationsFollowTheLineWhenNothingMoves) {
  const line_task::LineCalibration known = PerfectCalibration(Truth());
  LineTrackingPlant plant(Truth(), &known);
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
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
    // The deviation has two parts: the initial error, whose standard deviation is 0.6 mm, and the
    // residual that no calibration can remove.
    EXPECT_LT(farthest, LineTrackingPlant::kCollision);
    // The mean of this residual is 0.5 mm, and it occurs at the beginning and at the end.
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

// A disturbance during controls advances with the travel, and a disturbance between controls
// advances with the number of controls.
TEST(LineTrackingPlantTest, DisturbanceActsDuringOrBetweenControlsAsConfigured) {
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

// Without further motion, a platform settles at its commanded pose with its time constant.
TEST(LineTrackingPlantTest, DrivenPlatformLagsBehindItsCommand) {
  LineTrackingPlant plant(Truth(Wave::kRandom));
  plant.Reset(7);
  const kinematics::PsmJoints reading = plant.reported_joints();
  const test::NoAlloc guard;
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

TEST(LineTrackingPlantTest, CloneContinuesBitForBitAndSeedsDetermineEverything) {
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
