// Special kinds of tasks that a guard must handle: mixed units, rotations, repeated times.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/sim/gallery/gallery.h"
#include "tests/sim_gallery/gallery_plants.h"

namespace dfr::sim {
namespace {

constexpr std::uint64_t kDemonstrations = 20;

// The supervisor acts while `going` holds. Then the same control is applied `times` times.
TEST(GalleryTest, WrongActionsFail) {
  using State = std::vector<double>;
  struct Case {
    const char* what;
    const char* task;
    bool (*going)(const State& x);
    State control;
    int times;
    bool fails = true;
  };
  const auto at_once = [](const State&) { return false; };
  const auto pick_is_low = [](const State& x) { return x[6] < 0.05; };
  const auto grasp_is_low = [](const State& x) { return x[4] < 0.05; };
  const auto is_open = [](const State& x) { return x[2] < 1.0; };
  const auto is_wide_open = [](const State& x) { return x[2] < 0.5; };
  const auto is_off_the_handle = [](const State& x) { return std::hypot(x[0] - 0.4, x[1]) > 0.01; };
  const auto is_off_the_middle = [](const State& x) { return std::hypot(x[0], x[1]) > 0.04; };
  for (const Case& c : {
           Case{"releases in the air", "pick", pick_is_low, {0.0, 0.0, 0.0, -1.0}, 1},
           Case{"releases in the air", "grasp", grasp_is_low, {0.0, 0.0, -1.0}, 5},
           Case{"releases on the table", "grasp", is_open, {0.0, 0.0, -1.0}, 5, false},
           Case{"leaves before it is closed", "grasp", is_wide_open, {0.0, 1.0, 0.0}, 3},
           Case{"pulls a latched door", "door", is_off_the_handle, {0.0, 0.7, 0.0}, 2},
           Case{"turns without pressing", "screw", at_once, {0.7, 0.0}, 20},
           Case{"presses too hard", "screw", at_once, {0.0, -1.0}, 20},
           Case{"turns off to the left", "figure-eight", is_off_the_middle, {-0.5, 0.6}, 8},
       }) {
    SCOPED_TRACE(testing::Message() << c.task << ": " << c.what);
    const auto plant = Make(FindGalleryTask(c.task));
    plant->Reset(1);
    Supervise(*plant, c.going);
    ASSERT_FALSE(plant->collided());
    for (int i = 0; i < c.times; ++i) Apply(*plant, c.control);
    EXPECT_EQ(plant->collided(), c.fails);
  }
}

TEST(PickTest, ActionsAreMetresAndTheGripperHasTwoValues) {
  const auto plant = Make(FindGalleryTask("pick"));
  plant->Reset(1);
  const auto before = State(*plant);
  Apply(*plant, {0.01, -0.02, 0.005, 0.3});
  const auto after = State(*plant);
  EXPECT_NEAR(after[0] - before[0], 0.01, 1e-12);
  EXPECT_NEAR(after[1] - before[1], -0.02, 1e-12);
  EXPECT_NEAR(after[2] - before[2], 0.005, 1e-12);
  EXPECT_EQ(after[3] - before[3], 0.25);  // the speed does not depend on the action's size
  const core::Trajectory trajectory = DemonstrateOnce(FindGalleryTask("pick"), 3);
  for (int t = 0; t < trajectory.num_steps(); ++t) {
    ASSERT_EQ(std::abs(trajectory.controls(t, 3)), 1.0);
    ASSERT_LT(trajectory.controls.row(t).head(3).cwiseAbs().maxCoeff(), 0.03);
  }
}

TEST(DoorTest, TheQuaternionIsAUnitAndItsSignFlipsInEveryDemonstration) {
  for (std::uint64_t seed = 0; seed < kDemonstrations; ++seed) {
    const core::Trajectory trajectory = DemonstrateOnce(FindGalleryTask("door"), seed);
    int flips = 0;
    for (int t = 0; t <= trajectory.num_steps(); ++t) {
      const auto q = trajectory.states.row(t).segment(2, 4);
      ASSERT_NEAR(q.norm(), 1.0, 1e-12);
      ASSERT_GE(q[0], 0.0);
      if (t > 0) flips += q.dot(trajectory.states.row(t - 1).segment(2, 4)) < -0.9 ? 1 : 0;
    }
    EXPECT_GE(flips, 1);
  }
}

TEST(ScrewTest, TheAngleRunsOnForTwoAndAHalfTurnsAndTheHeadSinks) {
  const core::Trajectory trajectory = DemonstrateOnce(FindGalleryTask("screw"), 4);
  double turned = 0.0;
  for (int t = 1; t <= trajectory.num_steps(); ++t) {
    const auto a = trajectory.states.row(t - 1);
    const auto b = trajectory.states.row(t);
    ASSERT_NEAR(std::hypot(b[0], b[1]), 1.0, 1e-12);
    turned += std::atan2(a[0] * b[1] - a[1] * b[0], a[0] * b[0] + a[1] * b[1]);
    ASSERT_NEAR(trajectory.states(0, 3) - b[3], 0.2 * turned / (2.0 * std::numbers::pi), 0.02);
  }
  EXPECT_GT(turned, 4.95 * std::numbers::pi);
}

TEST(BimanualTest, ThirtyEntriesFollowFromFourteenJoints) {
  const auto plant = Make(FindGalleryTask("bimanual"));
  ASSERT_EQ(plant->state_dim(), 30);
  ASSERT_EQ(plant->control_dim(), 14);
  plant->Reset(1);
  core::Random random(5);
  for (int t = 0; t < 10; ++t) {
    std::vector<double> u(14);
    for (double& entry : u) entry = random.Uniform(-0.2, 0.2);
    Apply(*plant, u);
    const auto x = State(*plant);
    std::vector<double> tips;
    for (std::size_t arm = 0; arm < 2; ++arm) {
      double angle = 0.0, tip_x = arm == 0 ? -0.35 : 0.35, tip_y = 0.0;
      for (std::size_t i = 0; i < 7; ++i) {
        angle += x[7 * arm + i];
        tip_x += std::cos(angle) / 7.0;
        tip_y += std::sin(angle) / 7.0;
      }
      ASSERT_NEAR(x[14 + 2 * arm], tip_x, 1e-12);
      ASSERT_NEAR(x[15 + 2 * arm], tip_y, 1e-12);
      ASSERT_NEAR(x[18 + arm], angle, 1e-12);
      tips.insert(tips.end(), {tip_x, tip_y});
    }
    ASSERT_NEAR(x[27], std::hypot(tips[2] - tips[0], tips[3] - tips[1]), 1e-12);
    ASSERT_NEAR(x[28] + x[24], 0.12, 1e-12);
  }
}

TEST(BimanualTest, FailsWhenTheBarIsPulledApart) {
  const auto plant = Make(FindGalleryTask("bimanual"));
  plant->Reset(2);
  std::vector<double> u(14, 0.0);
  u[0] = 1.0;  // the left arm turns away
  bool pulled = false;
  for (int t = 0; t < 10 && !plant->collided(); ++t) {
    Apply(*plant, u);
    pulled = std::abs(State(*plant)[27] - 0.3) > 0.12;
    ASSERT_TRUE(!pulled || plant->collided());
  }
  EXPECT_TRUE(plant->collided());
}

TEST(WipeTest, WithoutPressingNothingIsWiped) {
  const auto plant = Make(FindGalleryTask("wipe"));
  plant->Reset(1);
  for (int t = 0; t < 20; ++t) Apply(*plant, {0.5, 0.0});
  EXPECT_EQ(State(*plant)[3], 0.0);
}

TEST(RopeTest, TheWrongWayRoundFailsAndTheHookAloneDoesNotComplete) {
  const auto plant = Make(FindGalleryTask("rope"));
  plant->Reset(1);
  Supervise(*plant, [](const std::vector<double>& x) { return std::hypot(x[0], x[1]) > 0.3; });
  const auto clone = plant->Clone();
  for (int t = 0; t < 60 && !clone->collided(); ++t) {  // clockwise
    const auto x = State(*clone);
    const double r = std::hypot(x[0], x[1]);
    Apply(*clone, {0.6 * x[1] / r, -0.6 * x[0] / r});
  }
  EXPECT_TRUE(clone->collided());
  bool there = false;
  for (int t = 0; t < 60; ++t) {  // moves below the peg and up to the hook
    const auto x = State(*plant);
    const double goal_y = x[0] < 0.3 ? -0.3 : 0.3;
    const double dx = x[0] < 0.3 ? 0.2 : 0.6 - x[0];
    const double norm = std::max(0.1, std::hypot(dx, goal_y - x[1]));
    Apply(*plant, {0.6 * dx / norm, 0.6 * (goal_y - x[1]) / norm});
    there = there || std::hypot(x[0] - 0.6, x[1] - 0.3) < 0.04;
  }
  EXPECT_TRUE(there);
  EXPECT_FALSE(plant->collided());
  EXPECT_FALSE(plant->completed());
}

TEST(FigureEightTest, TheMiddleIsPassedTwiceOnCrossingPaths) {
  for (std::uint64_t seed = 0; seed < kDemonstrations; ++seed) {
    const core::Trajectory trajectory = DemonstrateOnce(FindGalleryTask("figure-eight"), seed);
    int first = -1, last = -1;
    for (int t = 0; t < trajectory.num_steps(); ++t) {
      if (trajectory.states.row(t).head(2).norm() > 0.05) continue;
      if (first < 0) first = t;
      last = t;
    }
    ASSERT_GT(last - first, 30);
    const auto a = trajectory.states.row(first).tail(2);
    const auto b = trajectory.states.row(last).tail(2);
    EXPECT_LT(a.dot(b), 0.8 * a.norm() * b.norm());
  }
}

TEST(CrossingTest, TheShuttleMovesOnByItselfAtARandomPhase) {
  const auto plant = Make(FindGalleryTask("crossing"));
  double lowest = 1.0, highest = -1.0;
  for (std::uint64_t seed = 0; seed < 50; ++seed) {
    plant->Reset(seed);
    const auto other = plant->Clone();
    lowest = std::min(lowest, State(*plant)[2]);
    highest = std::max(highest, State(*plant)[2]);
    for (int t = 0; t < 5; ++t) {
      Apply(*plant, {0.3, 0.2});
      Apply(*other, {-0.4, 0.0});
    }
    EXPECT_EQ(State(*plant)[2], State(*other)[2]);
  }
  EXPECT_LT(lowest, -0.4);
  EXPECT_GT(highest, 0.4);
}

TEST(CrossingTest, StoppingOnTheLaneFailsAndWaitingDoesNot) {
  for (const double stop : {0.2, 0.5}) {
    const auto plant = Make(FindGalleryTask("crossing"));
    plant->Reset(1);
    Apply(*plant, {0.0, -State(*plant)[1] / 0.04});
    for (int t = 0; t < 80; ++t) {
      Apply(*plant, {std::min(0.8, (stop - State(*plant)[0]) / 0.04), 0.0});
    }
    EXPECT_EQ(plant->collided(), stop == 0.5);
  }
}

TEST(JointsTest, HalfOfAMotionCarriesOverAndTheShoulderSags) {
  const auto plant = Make(FindGalleryTask("joints"));
  plant->Reset(1);
  const auto before = State(*plant);
  Apply(*plant, {0.0, 0.1, 0.0, 0.0, 0.0});
  const auto after = State(*plant);
  EXPECT_NEAR(after[1] - before[1], 0.05, 1e-12);
  EXPECT_NEAR(after[0] - before[0], -0.003 * std::cos(before[0]), 1e-5);
  Apply(*plant, {0.0, 0.0, 0.0, 0.0, 0.0});
  EXPECT_NEAR(State(*plant)[1] - after[1], 0.025, 1e-12);
}

}  // namespace
}  // namespace dfr::sim
