#include "dfr/sim/dvrk_scene/dvrk_scene.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "tests/support/all_close.h"

namespace dfr::sim {
namespace {

using kinematics::PsmJoints;

constexpr double kSample = 0.02;  // s, time between two checks of the tip's distance in the plant

DvrkSceneOptions LockStep(Wave wave = Wave::kRandom) {
  DvrkSceneOptions options;
  options.linger_s = 0.0;
  options.arm.homing_s = 0.1;
  options.world.disturbance.wave = wave;
  return options;
}

DvrkSceneOptions RealTime(bool during, bool between) {
  DvrkSceneOptions options = LockStep();
  options.linger_s = 0.05;
  options.world.disturbance.during = during;
  options.world.disturbance.between = between;
  return options;
}

// Returns the duration of a control in the plant, s.
double Duration(const std::array<double, 2>& u) {
  const Eigen::Vector3d step(LineTrackingPlant::kStep * u[0], LineTrackingPlant::kStep * u[1], 0.0);
  return step.norm() / LineTrackingPlant::kSpeed;
}

// A client sends the joints of a motion, one set-point per sample of the plant. The scene then
// moves as a control moves the plant.
TEST(DvrkSceneTest, SteppedByAClientItEqualsThePlantBitForBit) {
  for (const bool between : {false, true}) {
    DvrkSceneOptions options = LockStep();
    options.world.disturbance.between = between;
    DvrkScene scene(options);
    LineTrackingOptions world = options.world;
    world.observation = Observation::kGroundTruth;
    LineTrackingPlant plant(world);
    scene.Reset(3);
    plant.Reset(3);
    for (int i = 0; i < 25; ++i) {
      const std::array<double, 2> u = {0.6 + 0.4 * std::sin(i), 0.4 * std::cos(3.0 * i)};
      const PsmJoints from = scene.console().measured_joints();
      ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
      const PsmJoints to = plant.reported_joints();
      const double duration_s = Duration(u);
      const int samples = static_cast<int>(std::ceil(duration_s / kSample));
      for (int k = 1; k <= samples; ++k) {
        scene.console().ServoJp(from + (to - from) * (static_cast<double>(k) / samples));
        scene.Step(duration_s / samples);
      }
      scene.console().ServoJp(to);
      scene.Rest();
      ASSERT_EQ(scene.plant().TrueState(), plant.TrueState()) << "control " << i;
      ASSERT_EQ(scene.plant().collided(), plant.collided());
      ASSERT_EQ(scene.plant().completed(), plant.completed());
    }
  }
}

TEST(DvrkSceneTest, ResetPutsTheHomedArmOverTheLinesBeginning) {
  DvrkScene scene(LockStep());
  scene.console().StateCommand("home");
  scene.Step(0.05);
  scene.console().Fail("a cable is off");
  scene.Reset(5);
  EXPECT_EQ(scene.seed(), 5U);
  EXPECT_EQ(scene.console().state(), ArmState::kEnabled);
  EXPECT_TRUE(scene.console().homed());
  EXPECT_FALSE(scene.console().busy());
  EXPECT_EQ(scene.console().measured_joints(), scene.plant().reported_joints());
  EXPECT_EQ(scene.console().setpoint_joints(), scene.plant().reported_joints());
  const double progress = scene.plant().truth().progress_m;
  for (int i = 0; i < 50; ++i) scene.Step(0.02);
  // The cables creep slightly, and nothing else moves.
  EXPECT_NEAR(scene.plant().truth().progress_m, progress, 1e-4);
}

TEST(DvrkSceneTest, HomingMovesTheTipOverTheGauzesMiddle) {
  DvrkScene scene(LockStep(Wave::kNone));
  const Eigen::Vector3d start = scene.plant().truth().tip_m;
  scene.Step(0.05);
  EXPECT_TRUE(test::AllClose(scene.plant().truth().tip_m, start, 1e-4));  // creep
  scene.console().StateCommand("home");
  for (int i = 0; i < 20; ++i) scene.Step(0.01);
  ASSERT_TRUE(scene.console().homed());
  // The remaining distance is the error of an uncalibrated arm.
  EXPECT_LT(scene.plant().truth().tip_m.norm(), 0.012);
  EXPECT_GT(start.norm(), 0.018);
}

// Set-points arrive at most at a few hundred hertz, and the console's steps are shorter. The arm is
// assumed to move between two set-points.
TEST(DvrkSceneTest, InRealTimeThePlatformMovesWithTheArmOrWithoutIt) {
  const auto moved = [](const DvrkSceneOptions& options, int every_ms) {
    DvrkScene scene(options);
    scene.Reset(6);
    scene.Step(0.1);  // longer than linger_s: the arm counts as resting
    const Eigen::Vector3d before = scene.plant().platform_setpoint().translation_m;
    PsmJoints goal = scene.console().setpoint_joints();
    for (int ms = 0; ms < 500; ++ms) {
      if (every_ms > 0 && ms % every_ms == 0) {
        goal[3] += 1e-4;
        scene.console().ServoJp(goal);
      }
      scene.Step(1e-3);
    }
    return (scene.plant().platform_setpoint().translation_m - before).norm();
  };
  EXPECT_EQ(moved(RealTime(true, false), 0), 0.0);
  EXPECT_EQ(moved(RealTime(false, true), 10), 0.0);
  EXPECT_EQ(moved(RealTime(false, false), 10), 0.0);
  EXPECT_GT(moved(RealTime(false, true), 0), 1e-4);
  const double with_the_arm = moved(RealTime(true, false), 10);
  EXPECT_GT(with_the_arm, 1e-4);
  // The disturbance also acts between set-points: the platform moves as far with fewer set-points.
  EXPECT_EQ(with_the_arm, moved(RealTime(true, false), 1));
}

TEST(DvrkSceneTest, CameraFaultsPersistThroughAReset) {
  DvrkScene scene(LockStep());
  const auto brightness = [&scene] {
    std::vector<std::uint8_t> picture(scene.plant().endoscope().image_size());
    scene.plant().RenderPicture(1, picture);
    return std::accumulate(picture.begin(), picture.end(), 0.0) /
           static_cast<double>(picture.size());
  };
  scene.SetCameraFault(CameraFault::kBlack);
  scene.Reset(1);
  const double dark = brightness();
  EXPECT_LT(dark, 5.0);  // noise alone
  scene.SetCameraFault(CameraFault::kNone);
  EXPECT_GT(brightness(), 10.0 * dark);
}

TEST(DvrkSceneTest, OptionsOutOfRangeAreRefused) {
  DvrkSceneOptions options = LockStep();
  options.linger_s = -1.0;
  EXPECT_THROW(DvrkScene{options}, std::invalid_argument);
  options = LockStep();
  options.world.max_curvature = 1.0;
  EXPECT_THROW(DvrkScene{options}, std::invalid_argument);
}

}  // namespace
}  // namespace dfr::sim
