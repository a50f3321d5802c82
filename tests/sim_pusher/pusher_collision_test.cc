// Collisions of the arm and of the cylinder with the red regions.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/sim/pusher/pusher_plant.h"
#include "tests/sim_pusher/arm_kinematics.h"

namespace dfr::sim {
namespace {

using core::PlantStatus;
using test::MoveTip;
using test::Observe;
using test::WithObjectAt;
using State = std::vector<double>;
using Control = std::array<double, 7>;

double PostDistance(const Eigen::Vector3d& p, double red_y) {
  constexpr double kTableZ = -0.325;
  const double z = std::clamp(p.z(), kTableZ, kTableZ + 0.04);
  return (p - Eigen::Vector3d(0.64, red_y, z)).norm();
}

// Tests every arm pose by points sampled along the documented capsules.
TEST(PusherCollisionTest, CollisionsOfArmPartsAgreeWithSampledDistances) {
  PusherPlant plant;
  core::Random random(12);
  State s = WithObjectAt(Observe(plant), 0.45, 0.0);
  std::map<std::string, int> hits;
  int free_poses = 0;
  for (int i = 0; i < 4000; ++i) {
    const double centers[] = {0.0, 0.3, 0.0, 1.0, 0.0, -0.3, 0.0};
    const double widths[] = {0.6, 0.9, 1.0, 0.8, 1.0, 1.2, 1.4};
    for (int j = 0; j < 7; ++j) s[j] = centers[j] + random.Uniform(-widths[j], widths[j]);
    double closest = 1.0;
    std::vector<std::string> touching;
    for (const auto& part : test::Forward(s, 0.025).parts) {
      double clearance = 1.0;
      for (int k = 0; k <= 100; ++k) {
        const Eigen::Vector3d p = part.a + 0.01 * k * (part.b - part.a);
        for (const double red_y : {0.15, -0.15}) {
          clearance =
              std::min(clearance, PostDistance(p, red_y) - part.radius - PusherPlant::kRedRadius);
        }
      }
      if (clearance < 0.0) touching.push_back(part.name);
      if (std::abs(clearance) < std::abs(closest)) closest = clearance;
    }
    // Samples are at most 3.2 mm apart. A sampled distance of about 7 cm is therefore accurate to
    // 0.02 mm.
    if (std::abs(closest) < 1e-4) continue;
    plant.SetState(s);
    ASSERT_EQ(plant.collided(), !touching.empty()) << "pose " << i;
    if (plant.collided()) {
      ASSERT_THAT(touching, testing::Contains(std::string(plant.collided_part())));
      ++hits[std::string(plant.collided_part())];
    } else {
      ++free_poses;
    }
  }
  EXPECT_GT(free_poses, 260);
  for (const char* part : {"forearm", "hand", "bar"}) EXPECT_GE(hits[part], 10) << part;
  EXPECT_EQ(hits["upper_arm"], 0) << "cannot reach the regions: 0.5 + 0.045 < 0.657 - 0.06";
}

TEST(PusherCollisionTest, ForkProngsCollideToo) {
  PusherPlant plant({.gripper = Gripper::kFork, .red_y = 0.16});
  State s = WithObjectAt(Observe(plant), 0.45, 0.0);
  const State home = s;
  std::map<std::string, int> hits;
  core::Random random(3);
  for (int i = 0; i < 5000; ++i) {
    const double widths[] = {0.6, 0.5, 0.4, 1.2, 0.4, 0.8, 0.6};
    for (int j = 0; j < 7; ++j) s[j] = home[j] + random.Uniform(-widths[j], widths[j]);
    s[3] = std::min(s[3], 2.7);
    plant.SetState(s);
    if (plant.collided()) ++hits[std::string(plant.collided_part())];
  }
  EXPECT_GT(hits["prong_left"], 0);
  EXPECT_GT(hits["prong_right"], 0);
}

// The cylinder collides at the sum of the radii, and completes the task with its centre over the
// goal.
TEST(PusherCollisionTest, TheCylindersPositionDeterminesTheOutcome) {
  struct Case {
    double x, y;
    bool collided, completed;
  };
  PusherPlant plant;
  const State home = Observe(plant);
  for (const Case& c :
       {Case{0.64, 0.0499, false, false}, Case{0.64, 0.0501, true, false},
        Case{0.64, -0.0501, true, false}, Case{0.64 - 0.1001, 0.15, false, false},
        Case{0.7201, 0.0, false, true}, Case{0.7199, 0.0, false, false},
        Case{0.76, 0.0399, false, true}, Case{0.76 + 0.029, -0.029, false, false}}) {
    SCOPED_TRACE(testing::Message() << c.x << ", " << c.y);
    plant.SetState(WithObjectAt(home, c.x, c.y));
    EXPECT_EQ(plant.collided(), c.collided);
    EXPECT_EQ(plant.collided_part(), c.collided ? "object" : "");
    EXPECT_EQ(plant.completed(), c.completed);
  }
}

TEST(PusherCollisionTest, PushingTheCylinderIntoARegionCollidesAndStaysSo) {
  PusherPlant plant;
  plant.SetState(WithObjectAt(Observe(plant), 0.45, 0.0));
  int t = 0;
  for (; t < 60 && !plant.collided(); ++t) {
    ASSERT_EQ(plant.Apply(MoveTip(plant, {0.014, 0.005})), PlantStatus::kOk);
    ASSERT_FALSE(plant.completed());
  }
  ASSERT_TRUE(plant.collided());
  EXPECT_EQ(plant.collided_part(), "object");
  const auto clone = plant.Clone();
  EXPECT_TRUE(clone->collided());
  plant.SetState(WithObjectAt(Observe(plant), 0.45, 0.0));
  EXPECT_FALSE(plant.collided());
  for (int back = 0; back < 10; ++back) {
    ASSERT_EQ(clone->Apply(MoveTip(plant, {-0.014, -0.005})), PlantStatus::kOk);
  }
  EXPECT_TRUE(clone->collided()) << "since Reset()";
  clone->Reset(0);
  EXPECT_FALSE(clone->collided());
}

// The path between poses counts: a control with both ends free can cut a region's corner.
TEST(PusherCollisionTest, CollisionsAlongThePathCount) {
  PusherPlant plant;
  PusherPlant judge;
  core::Random random(21);
  State s = WithObjectAt(Observe(plant), 0.45, 0.0);
  const Eigen::Matrix<double, 7, 1> home = Eigen::Map<Eigen::Matrix<double, 7, 1>>(s.data());
  int only_between = 0;
  for (int i = 0; i < 30000 && only_between < 1; ++i) {
    const double widths[] = {0.6, 0.6, 0.4, 1.2, 0.4, 0.8, 0.6};
    for (int j = 0; j < 7; ++j) s[j] = home[j] + random.Uniform(-widths[j], widths[j]);
    s[3] = std::min(s[3], 2.7);
    plant.SetState(s);
    if (plant.collided()) continue;
    Control control;
    for (double& u : control) u = random.Uniform() < 0.5 ? -1.0 : 1.0;
    const auto before = plant.statistics();
    ASSERT_EQ(plant.Apply(control), PlantStatus::kOk);
    if (plant.statistics().stopped_by_table > before.stopped_by_table) continue;
    if (plant.statistics().stalled > before.stalled) continue;
    const State end = Observe(plant);
    const std::string part(plant.collided_part());
    const bool on_the_way = plant.collided();
    judge.SetState(WithObjectAt(end, 0.45, 0.0));
    if (judge.collided()) {
      EXPECT_TRUE(on_the_way);
      continue;
    }
    if (!on_the_way || part == "object") continue;
    bool found = false;
    State between = s;
    for (int k = 1; k < 400 && !found; ++k) {
      for (int j = 0; j < 7; ++j) between[j] = s[j] + (end[j] - s[j]) * k / 400.0;
      judge.SetState(between);
      found = judge.collided();
    }
    EXPECT_TRUE(found) << part;
    ++only_between;
  }
  EXPECT_EQ(only_between, 1);
}

}  // namespace
}  // namespace dfr::sim
