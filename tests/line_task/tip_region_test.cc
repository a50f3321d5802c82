#include "dfr/line_task/tip_region.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <limits>
#include <stdexcept>
#include <string>

#include "dfr/core/random.h"
#include "tests/support/no_alloc.h"

namespace dfr::line_task {
namespace {

using kinematics::PsmJoints;

// The arm hangs over the gauze's middle, with its tool straight down.
Eigen::Isometry3d Overhead() {
  Eigen::Isometry3d base = Eigen::Isometry3d::Identity();
  base.translation().z() = 0.13;
  return base;
}

class TipRegionTest : public testing::Test {
 protected:
  // Returns readings that hold the tool upright with its tips at this position.
  PsmJoints At(double x, double y, double z) {
    PsmJoints joints;
    EXPECT_TRUE(task_.Reading({x, y, z}, joints));
    return joints;
  }
  static std::string Named(const Breach& breach) { return breach.any() ? breach.what : ""; }

  LineTask task_{LineCalibration{}, Overhead()};
};

TEST_F(TipRegionTest, NamesTheViolatedBoundAndItsDepth) {
  TipRegionOptions options;
  options.box_min_m = {-0.02, -0.02, 0.001};
  options.box_max_m = {0.02, 0.02, 0.03};
  options.forbidden = {{Eigen::Vector3d(0.01, -0.02, 0.0), Eigen::Vector3d(0.02, 0.02, 0.005)}};
  options.planes = {{Eigen::Vector3d(0.6, 0.0, 0.8), 0.0}};
  const TipRegion region(task_, options);
  EXPECT_FALSE(region.At({0.0, 0.0, 0.01}).any());
  const auto expect = [&](const Eigen::Vector3d& tip, const char* what, double depth_m) {
    const Breach breach = region.At(tip);
    EXPECT_EQ(Named(breach), what);
    EXPECT_NEAR(breach.depth_m, depth_m, 1e-12);
  };
  expect({0.0, 0.0, 0.0004}, "the floor", 0.0006);
  expect({0.0, 0.025, 0.01}, "the task's box", 0.005);
  expect({0.0, 0.0, 0.032}, "the task's box", 0.002);
  expect({0.013, 0.0, 0.004}, "a forbidden box", 0.001);
  expect({-0.015, 0.0, 0.005}, "a plane", 0.015 * 0.6 - 0.005 * 0.8);
  EXPECT_TRUE(std::isinf(region.At({std::nan(""), 0.0, 0.0}).depth_m));
}

// Both ends of the path are above the floor. Between the ends the wrist moves the tips down.
TEST_F(TipRegionTest, APathIsCheckedAlongItsLength) {
  const TipRegion region(task_, {});
  PsmJoints bent = At(0.0, 0.0, 0.002);
  bent[4] = 0.9;
  PsmJoints back = bent;
  back[4] = -0.9;
  EXPECT_FALSE(region.At(task_.Tip(bent)).any());
  EXPECT_FALSE(region.At(task_.Tip(back)).any());
  PsmJoints lower_bent = bent;
  lower_bent[2] += 0.003;
  PsmJoints lower_back = back;
  lower_back[2] += 0.003;
  EXPECT_FALSE(region.At(task_.Tip(lower_bent)).any());
  EXPECT_EQ(Named(region.Along(lower_bent, lower_back)), "the floor");
  EXPECT_FALSE(region.Along(lower_bent, bent).any());
}

// Seeded paths are compared with checks that are twenty times as dense. About one path in ten
// leaves the region. Each path that leaves by more than 0.1 mm is rejected.
TEST_F(TipRegionTest, NoPathThatLeavesIsAllowed) {
  const TipRegion region(task_, {});
  core::Random random(5);
  int refused = 0;
  for (int n = 0; n < 100; ++n) {
    PsmJoints from = At(0.0, 0.0, 0.003);
    PsmJoints to = from;
    for (int i = 0; i < 6; ++i) {
      from[i] += (i == 2 ? 0.005 : 0.2) * random.Uniform(-1.0, 1.0);
      to[i] += (i == 2 ? 0.005 : 0.2) * random.Uniform(-1.0, 1.0);
    }
    if (region.At(task_.Tip(from)).any()) continue;
    double deepest = 0.0;
    for (int i = 0; i <= 4000; ++i) {
      deepest = std::max(deepest, region.At(task_.Tip(from + i / 4000.0 * (to - from))).depth_m);
    }
    const Breach found = region.Along(from, to);
    refused += found.any() ? 1 : 0;
    if (!found.any()) {
      // Along() checks every half millimetre. Between two checks a curved path may be slightly
      // deeper.
      EXPECT_LT(deepest, 1e-4);
    } else {
      EXPECT_NEAR(found.depth_m, deepest, 3e-4);
    }
  }
  EXPECT_GT(refused, 5);
}

TEST_F(TipRegionTest, FromTooDeepOnlyThePathOutIsAllowed) {
  const TipRegion region(task_, {});
  const PsmJoints below = At(0.0, 0.0, -0.002);
  EXPECT_FALSE(region.Along(below, At(0.0, 0.0, 0.003)).any());
  EXPECT_FALSE(region.Along(below, At(0.0, 0.0, -0.001)).any());
  EXPECT_EQ(Named(region.Along(below, At(0.0, 0.0, -0.003))), "the floor");
  // A longer insertion leads deeper.
  PsmJoints end = below;
  end[2] += 0.001;
  EXPECT_TRUE(region.Along(below, end).any());
  end[2] = std::nan("");
  EXPECT_TRUE(region.Along(below, end).any());
  EXPECT_TRUE(region.Along(end, end).any());
}

// A tip that violates one bound must not violate another.
TEST_F(TipRegionTest, FromOutsideOneBoundAnotherBoundStillHolds) {
  TipRegionOptions options;
  options.box_max_m = {0.02, 0.05, 0.06};
  options.forbidden = {{Eigen::Vector3d(0.0, -0.05, 0.0), Eigen::Vector3d(0.016, 0.05, 0.006)}};
  options.planes = {{Eigen::Vector3d(0.0, 1.0, 0.0), 0.003}};  // y >= -3 mm
  const TipRegion region(task_, options);
  const PsmJoints outside = At(0.03, 0.0, 0.002);  // by 10 mm
  ASSERT_EQ(Named(region.At(task_.Tip(outside))), "the task's box");
  EXPECT_FALSE(region.Along(outside, At(0.021, 0.0, 0.002)).any());
  EXPECT_EQ(Named(region.Along(outside, At(0.025, 0.0, -0.002))), "the floor");
  EXPECT_EQ(Named(region.Along(outside, At(0.018, -0.006, 0.002))), "a plane");
  EXPECT_EQ(Named(region.Along(outside, At(0.014, 0.0, 0.002))), "a forbidden box");
  EXPECT_EQ(Named(region.Along(outside, At(0.025, 0.052, 0.002))), "the task's box");
}

TEST_F(TipRegionTest, TheObservedGauzeIsABound) {
  TipRegion region(task_, {});
  const Eigen::Vector3d tip(0.02, 0.0, 0.004);
  EXPECT_FALSE(region.At(tip).any());
  Eigen::Isometry3d gauze = Eigen::Isometry3d::Identity();
  gauze.linear() = Eigen::AngleAxisd(-0.2, Eigen::Vector3d::UnitY()).toRotationMatrix();
  region.SetGauze(gauze);  // the +x side is raised by 0.2 rad
  const Breach breach = region.At(tip);
  EXPECT_EQ(Named(breach), "the observed gauze");
  EXPECT_NEAR(breach.depth_m, 0.0005 + 0.02 * std::sin(0.2) - 0.004 * std::cos(0.2), 1e-12);
  region.ForgetGauze();
  EXPECT_FALSE(region.At(tip).any());
}

TEST_F(TipRegionTest, NeverAllocates) {
  const TipRegion region(task_, {});
  const PsmJoints from = At(0.0, 0.0, 0.003);
  const PsmJoints to = At(0.01, 0.01, 0.003);
  const test::NoAlloc no_alloc;
  EXPECT_FALSE(region.Along(from, to).any());
}

TEST_F(TipRegionTest, InvalidBoundsAreRefused) {
  using Change = void (*)(TipRegionOptions&);
  for (const Change change : std::initializer_list<Change>{
           [](auto& o) { o.box_max_m.x() = std::numeric_limits<double>::infinity(); },
           [](auto& o) { o.box_max_m.z() = 0.0; }, [](auto& o) { o.forbidden.emplace_back(); },
           [](auto& o) { o.planes.emplace_back(Eigen::Vector3d(0.0, 0.0, 2.0), 0.0); }}) {
    TipRegionOptions options;
    change(options);
    EXPECT_THROW(TipRegion(task_, options), std::invalid_argument);
  }
}

}  // namespace
}  // namespace dfr::line_task
