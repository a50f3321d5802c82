#include "dfr/sim/gallery/disc_push.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/no_alloc.h"

namespace dfr::sim {
namespace {

TEST(DiscPushPlantTest, ThePusherNeverOverlapsTheObjectAndPushesStraight) {
  const DiscPushOptions options{.start_y = 0.0, .rotation = 0.0};
  DiscPushPlant plant(options);
  plant.Reset(1);
  std::vector<double> x(4);
  plant.Observe(x);
  const double object_before = x[2];
  for (int i = 0; i < 8; ++i) ASSERT_EQ(plant.Apply(std::vector{1.0, 0.0}), core::PlantStatus::kOk);
  plant.Observe(x);
  EXPECT_NEAR(x[0], 8 * options.step, 1e-12);
  EXPECT_NEAR(x[2], x[0] + options.object_radius + options.pusher_radius, 1e-12);
  EXPECT_GT(x[2], object_before);
  EXPECT_NEAR(x[3], 0.0, 1e-12);
}

// Without friction the object moves only along the line of centres, and only when touched.
TEST(DiscPushPlantTest, TheObjectMovesOnlyWhenTouchedAndStaysTouching) {
  DiscPushPlant plant;
  core::Random random(2);
  std::vector<double> before(4), after(4), u(2);
  const double contact = plant.options().object_radius + plant.options().pusher_radius;
  int touched = 0;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    plant.Reset(seed);
    for (int i = 0; i < 30; ++i) {
      plant.Observe(before);
      u = {random.Uniform(0.0, 1.0), random.Uniform(-1.0, 1.0)};
      ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
      plant.Observe(after);
      const double distance = std::hypot(after[2] - after[0], after[3] - after[1]);
      ASSERT_GE(distance, contact - 1e-12);
      // Distance of the object's initial position from the pusher's straight path.
      const Eigen::Vector2d way(after[0] - before[0], after[1] - before[1]);
      const Eigen::Vector2d object(before[2] - before[0], before[3] - before[1]);
      const double along = std::clamp(object.dot(way) / way.squaredNorm(), 0.0, 1.0);
      const double reach = (object - along * way).norm();
      if (before[2] != after[2] || before[3] != after[3]) {
        ++touched;
        ASSERT_LT(reach, contact);
      } else {
        ASSERT_GT(reach, contact - 1e-5);  // the path is tested in substeps of 1 mm
      }
    }
  }
  EXPECT_GT(touched, 50);
}

TEST(DiscPushPlantTest, TheSupervisorPushesThroughTheGate) {
  DiscPushPlant plant;
  std::vector<double> u(2);
  int completed = 0;
  for (std::uint64_t seed = 0; seed < 100; ++seed) {
    plant.Reset(seed);
    for (int t = 0; t < 120 && !plant.completed() && !plant.collided(); ++t) {
      plant.Supervise({}, u);
      ASSERT_LE(std::hypot(u[0], u[1]), 0.7 + 1e-12);
      ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
    }
    completed += plant.completed() ? 1 : 0;
  }
  EXPECT_GE(completed, 98);
}

TEST(DiscPushPlantTest, TheGatesPostsCollide) {
  DiscPushPlant plant({.rotation = 0.0});
  plant.Reset(1);
  for (int i = 0; i < 40 && !plant.collided(); ++i) {
    ASSERT_EQ(plant.Apply(std::vector{0.9, 0.36}), core::PlantStatus::kOk);
  }
  EXPECT_TRUE(plant.collided());
  EXPECT_FALSE(plant.completed());
}

TEST(DiscPushPlantTest, ClonesContinueIdenticallyAndNothingAllocates) {
  DiscPushPlant plant;
  plant.Reset(5);
  const auto clone = plant.Clone();
  std::vector<double> a(4), b(4);
  const std::vector<double> u = {0.9, 0.1};
  {
    const test::NoAlloc guard;
    for (int i = 0; i < 10; ++i) {
      (void)plant.Apply(u);
      (void)clone->Apply(u);
    }
  }
  plant.Observe(a);
  clone->Observe(b);
  EXPECT_EQ(a, b);
  EXPECT_EQ(plant.Apply(std::vector{0.1}), core::PlantStatus::kRefused);
  EXPECT_THROW(DiscPushPlant({.gate_y = 0.05}), std::invalid_argument);
  EXPECT_THROW(DiscPushPlant({.start_x = 0.01}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::sim
