#include "dfr/sim/gallery/corridor.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <stdexcept>
#include <vector>

#include "dfr/core/random.h"
#include "tests/support/no_alloc.h"

namespace dfr::sim {
namespace {

// |x' - x| = K |u|, the assumption of Sec. IV-C with equality, turned by the rotation.
TEST(CorridorPlantTest, MovesByTheRotatedControlTimesTheGain) {
  const CorridorOptions options{.gain = 0.2, .rotation = 0.7};
  CorridorPlant plant(options);
  core::Random random(1);
  std::vector<double> before(2), after(2), u(2);
  plant.Reset(1);
  for (int i = 0; i < 100; ++i) {
    for (double& entry : u) entry = random.Uniform(-1.0, 1.0);
    plant.Observe(before);
    ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
    plant.Observe(after);
    const double dx = after[0] - before[0];
    const double dy = after[1] - before[1];
    ASSERT_NEAR(std::hypot(dx, dy), 0.2 * std::hypot(u[0], u[1]), 1e-14);
    ASSERT_NEAR(
        std::remainder(std::atan2(dy, dx) - std::atan2(u[1], u[0]) - 0.7, 2.0 * std::numbers::pi),
        0.0, 1e-12);
  }
}

TEST(CorridorPlantTest, ClearanceOfAStraightCorridorIsTheDistanceToTheWall) {
  const CorridorPlant plant({.amplitude = 0.0, .half_width = 0.3});
  EXPECT_NEAR(plant.Clearance(1.234, 0.0), 0.3, 1e-12);
  EXPECT_NEAR(plant.Clearance(1.234, -0.25), 0.05, 1e-12);
  EXPECT_LT(plant.Clearance(1.234, 0.31), 0.0);
  EXPECT_LT(plant.Clearance(1.234, 5.0), 0.0);
}

TEST(CorridorPlantTest, LeavingCollidesAndTheEndCompletes) {
  CorridorPlant plant({.length = 1.0, .amplitude = 0.0, .gain = 0.2, .rotation = 0.0});
  plant.Reset(1);
  for (int i = 0; i < 6; ++i) ASSERT_EQ(plant.Apply(std::vector{1.0, 0.0}), core::PlantStatus::kOk);
  EXPECT_TRUE(plant.completed());
  EXPECT_FALSE(plant.collided());
  plant.Reset(1);
  for (int i = 0; i < 6; ++i) ASSERT_EQ(plant.Apply(std::vector{0.0, 1.0}), core::PlantStatus::kOk);
  EXPECT_TRUE(plant.collided());
  EXPECT_FALSE(plant.completed());
}

TEST(CorridorPlantTest, TheSupervisorReachesTheEndWithAMargin) {
  CorridorPlant plant;
  std::vector<double> x(2), u(2);
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    plant.Reset(seed);
    for (int t = 0; t < 150 && !plant.completed(); ++t) {
      plant.Observe(x);
      plant.Supervise({}, u);
      ASSERT_EQ(plant.Apply(u), core::PlantStatus::kOk);
      plant.Observe(x);
      ASSERT_GT(plant.Clearance(x[0], x[1]), 0.02);
    }
    EXPECT_TRUE(plant.completed()) << seed;
  }
}

TEST(CorridorPlantTest, ClonesContinueIdenticallyAndInvalidControlsAreRefused) {
  CorridorPlant plant;
  plant.Reset(3);
  std::vector<double> a(2), b(2);
  ASSERT_EQ(plant.Apply(std::vector{0.5, 0.1}), core::PlantStatus::kOk);
  const auto clone = plant.Clone();
  ASSERT_EQ(plant.Apply(std::vector{0.1, -0.4}), core::PlantStatus::kOk);
  ASSERT_EQ(clone->Apply(std::vector{0.1, -0.4}), core::PlantStatus::kOk);
  plant.Observe(a);
  clone->Observe(b);
  EXPECT_EQ(a, b);
  EXPECT_EQ(plant.Apply(std::vector{0.1}), core::PlantStatus::kRefused);
  EXPECT_EQ(plant.Apply(std::vector{0.1, std::nan("")}), core::PlantStatus::kRefused);
  const std::vector<double> u = {2.0, -2.0};  // saturates
  const test::NoAlloc guard;
  (void)plant.Apply(u);
  plant.CopyStateFrom(*clone);
}

TEST(CorridorPlantTest, InvalidOptionsAreRefused) {
  EXPECT_THROW(CorridorPlant({.length = 0.0}), std::invalid_argument);
  EXPECT_THROW(CorridorPlant({.half_width = -1.0}), std::invalid_argument);
  EXPECT_THROW(CorridorPlant({.gain = 0.0}), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::sim
