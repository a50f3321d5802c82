#include "scene/line_tracking_scene.h"

#include <gtest/gtest.h>

#include "dfr/core/random.h"
#include "dfr/kinematics/sprk_platform.h"
#include "dfr/sim/line_tracking/line_tracking_plant.h"

namespace dfr::sim::internal {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

ScenePlaces Places() {
  return {LineTrackingPlant::p_world_base(), LineTrackingPlant::p_world_cam(), 0.7,
          LineTrackingPlant::target().marks_m};
}

PsmJoints RandomJoints(core::Random& random) {
  const PsmJoints low = Psm::lower_limits();
  const PsmJoints high = Psm::upper_limits();
  PsmJoints q;
  for (int i = 0; i < 6; ++i) q[i] = random.Uniform(low[i], high[i]);
  return q;
}

// The chain of bodies in the MJCF and the Denavit-Hartenberg table describe the same arm.
TEST(LineTrackingSceneTest, TheArmMatchesTheKinematics) {
  const SceneModel model(Places());
  SceneData data(model);
  core::Random random(1);
  for (int i = 0; i < 100; ++i) {
    const PsmJoints q = RandomJoints(random);
    data.Place(q, Eigen::Isometry3d::Identity());
    // Allows for the rounding of a chain of six rotations over 0.5 m.
    EXPECT_LT((data.tip_m() - LineTrackingPlant::p_world_base() * Psm::Tip(q)).norm(), 1e-14);
  }
}

TEST(LineTrackingSceneTest, TheGauzeHasTheGivenPose) {
  const SceneModel model(Places());
  SceneData data(model);
  kinematics::PlatformPose pose;
  pose.translation_m = {0.003, -0.002, 0.001};
  pose.angles_rad = {0.05, -0.04, 0.1};
  data.Place(PsmJoints::Zero(), pose.Transform());
  EXPECT_TRUE(data.p_world_gauze().isApprox(pose.Transform(), 1e-14));
}

}  // namespace
}  // namespace dfr::sim::internal
