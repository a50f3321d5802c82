#include "tests/sim_gallery/gallery_plants.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "dfr/core/random.h"
#include "dfr/sim/gallery/gallery.h"
#include "tests/support/no_alloc.h"

namespace dfr::sim {
namespace {

class EveryTaskTest : public testing::TestWithParam<std::string> {
 protected:
  const GalleryTask& task_ = FindGalleryTask(GetParam());
  std::vector<double> RandomControl(core::Random& random) const {
    std::vector<double> u(static_cast<std::size_t>(task_.plant->control_dim()));
    for (double& entry : u) entry = random.Uniform(-1.0, 1.0);
    return u;
  }
};

TEST_P(EveryTaskTest, ASeedDeterminesTheDemonstration) {
  const core::Trajectory a = DemonstrateOnce(task_, 5);
  const core::Trajectory b = DemonstrateOnce(task_, 5);
  const core::Trajectory c = DemonstrateOnce(task_, 6);
  EXPECT_EQ(a.states, b.states);
  EXPECT_EQ(a.controls, b.controls);
  EXPECT_NE(a.states.row(0), c.states.row(0));
}

TEST_P(EveryTaskTest, TheLayoutIsNamedAndUnitsFitTheControl) {
  for (const core::StateLayout::Block& block : task_.plant->layout().blocks) {
    EXPECT_FALSE(block.name.empty());
  }
  EXPECT_EQ(task_.plant->layout().state_dim(), task_.plant->state_dim());
  const auto size = static_cast<std::size_t>(task_.plant->control_dim());
  EXPECT_TRUE(task_.units.empty() || task_.units.size() == size);
  for (const int entry : task_.switches) EXPECT_LT(entry, task_.plant->control_dim());
  EXPECT_LE(task_.policy_bias.bias.size(), size);
}

TEST_P(EveryTaskTest, ACloneAndACopyContinueLikeTheOriginal) {
  core::Random random(7);
  const auto plant = Make(task_);
  const auto copy = Make(task_);
  plant->Reset(1);
  copy->Reset(2);
  for (int i = 0; i < 10; ++i) Apply(*plant, RandomControl(random));
  const auto clone = plant->Clone();
  copy->CopyStateFrom(*plant);
  for (int i = 0; i < 100; ++i) {
    const std::vector<double> u = RandomControl(random);
    Apply(*plant, u);
    Apply(*clone, u);
    Apply(*copy, u);
    ASSERT_EQ(State(*plant), State(*clone));
    ASSERT_EQ(State(*plant), State(*copy));
    ASSERT_EQ(plant->collided(), clone->collided());
    ASSERT_EQ(plant->collided(), copy->collided());
    ASSERT_EQ(plant->completed(), clone->completed());
    ASSERT_EQ(plant->completed(), copy->completed());
  }
}

// A moving world changes the observed state within a few steps after the start.
TEST_P(EveryTaskTest, AControlOfZeroHoldsStillUnlessTheWorldMovesOn) {
  const auto plant = Make(task_);
  plant->Reset(3);
  const std::vector<double> zero(static_cast<std::size_t>(plant->control_dim()), 0.0);
  for (int steps = 0; steps < 10; ++steps) {
    const std::vector<double> before = State(*plant);
    const bool failed = plant->collided();
    const auto still = plant->Clone();
    Apply(*still, zero);
    if (task_.settle_steps == 0) {
      ASSERT_EQ(State(*still), before);
      ASSERT_EQ(still->collided(), failed);
    } else if (steps > 0) {
      ASSERT_NE(State(*still), before);
    }
    std::vector<double> u = zero;
    plant->Supervise({}, u);
    Apply(*plant, u);
  }
}

TEST_P(EveryTaskTest, ControlsSaturateAndInvalidOnesAreRefused) {
  const auto plant = Make(task_);
  plant->Reset(4);
  const auto other = plant->Clone();
  const auto size = static_cast<std::size_t>(plant->control_dim());
  Apply(*plant, std::vector<double>(size, 7.0));
  Apply(*other, std::vector<double>(size, 1.0));
  EXPECT_EQ(State(*plant), State(*other));
  EXPECT_EQ(plant->Apply(std::vector<double>(size + 1, 0.0)), core::PlantStatus::kRefused);
  EXPECT_EQ(plant->Apply(std::vector<double>(size, std::numeric_limits<double>::quiet_NaN())),
            core::PlantStatus::kRefused);
  EXPECT_EQ(State(*plant), State(*other));
}

TEST_P(EveryTaskTest, TheSupervisorCompletes) {
  constexpr int kEpisodes = 100;
  int completed = 0;
  for (std::uint64_t seed = 0; seed < kEpisodes; ++seed) {
    const core::Trajectory trajectory = DemonstrateOnce(task_, seed);
    ASSERT_TRUE(trajectory.states.allFinite());
    ASSERT_LE(trajectory.controls.cwiseAbs().maxCoeff(), 1.0);
    completed += trajectory.outcome == core::Outcome::kCompleted ? 1 : 0;
  }
  EXPECT_GE(completed, 0.95 * kEpisodes);
}

TEST_P(EveryTaskTest, FailureIsPermanentAndNeverCompletes) {
  core::Random random(11);
  int failed = 0;
  const auto plant = Make(task_);
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    plant->Reset(seed);
    const std::vector<double> direction = RandomControl(random);
    bool was = false;
    for (int t = 0; t < 300; ++t) {
      std::vector<double> u = RandomControl(random);
      for (std::size_t i = 0; i < u.size(); ++i) u[i] = 0.3 * u[i] + direction[i];
      Apply(*plant, u);
      ASSERT_TRUE(plant->collided() || !was);
      ASSERT_FALSE(plant->collided() && plant->completed());
      was = plant->collided();
    }
    failed += was ? 1 : 0;
  }
  EXPECT_GE(failed, 1);
}

TEST_P(EveryTaskTest, ApplyingAllocatesNothing) {
  const auto plant = Make(task_);
  plant->Reset(1);
  std::vector<double> u(static_cast<std::size_t>(plant->control_dim()), 0.5);
  const test::NoAlloc guard;
  for (int t = 0; t < 50; ++t) (void)plant->Apply(u);
}

std::vector<std::string> Names() {
  std::vector<std::string> names;
  for (const GalleryTask& task : GalleryTasks()) names.push_back(task.name);
  return names;
}

INSTANTIATE_TEST_SUITE_P(Gallery, EveryTaskTest, testing::ValuesIn(Names()), [](const auto& task) {
  std::string name = task.param;
  std::erase(name, '-');
  return name;
});

TEST(GalleryTest, NamesAreDistinctAndHalfOfTheTasksAreHeldOut) {
  const std::vector<std::string> names = Names();
  EXPECT_EQ(std::set<std::string>(names.begin(), names.end()).size(), names.size());
  const auto held_out =
      std::ranges::count_if(GalleryTasks(), [](const GalleryTask& task) { return task.held_out; });
  EXPECT_EQ(static_cast<std::size_t>(held_out), names.size() / 2);  // rounded down
  EXPECT_THROW((void)FindGalleryTask("magic"), std::invalid_argument);
}

// The test has copies of the task's disc and region. Four checks per control suffice for straight
// lines.
TEST(PointTest, FailsExactlyAtChecksInsideThePillarOrOutsideTheRegion) {
  const auto plant = Make(FindGalleryTask("reach"));
  core::Random random(3);
  int failures = 0;
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    plant->Reset(seed);
    bool expected = false;
    const double heading = random.Uniform(-0.6, 0.6);
    for (int t = 0; t < 60; ++t) {
      const std::vector<double> from = State(*plant);
      const std::vector<double> u = {std::cos(heading), std::sin(heading)};
      for (int look = 1; look <= 4; ++look) {
        const double x = from[0] + 0.01 * look * u[0];
        const double y = from[1] + 0.01 * look * u[1];
        expected =
            expected || std::hypot(x - 0.55, y) < 0.2 || x < -0.4 || x > 1.4 || std::abs(y) > 0.8;
      }
      Apply(*plant, u);
      ASSERT_EQ(plant->collided(), expected) << "seed " << seed << ", t = " << t;
    }
    failures += expected ? 1 : 0;
  }
  EXPECT_EQ(failures, 40);  // all finally leave the region
}

TEST(PointTest, HalfOfAMotionCarriesOverIntoTheNextStep) {
  const auto plant = Make(FindGalleryTask("targets"));
  plant->Reset(1);
  const double start = State(*plant)[0];
  Apply(*plant, {0.5, 0.0});
  EXPECT_NEAR(State(*plant)[0] - start, 0.01, 1e-12);
  Apply(*plant, {0.0, 0.0});
  EXPECT_NEAR(State(*plant)[0] - start, 0.015, 1e-12);
}

TEST(PushTest, TheBoxTurnsAwayFromThePusherUnlessPushedAtItsCentre) {
  const auto plant = Make(FindGalleryTask("push"));
  for (std::uint64_t seed = 0; seed < 20; ++seed) {
    plant->Reset(seed);
    Supervise(*plant, [](const std::vector<double>& x) { return x[0] - x[2] < -0.07; });
    const std::vector<double> before = State(*plant);
    // Signed distance of the pusher's line from the box's centre.
    const double lever = -std::sin(before[4]) * (before[0] - before[2]) +
                         std::cos(before[4]) * (before[1] - before[3]);
    for (int t = 0; t < 4; ++t) Apply(*plant, {std::cos(before[4]), std::sin(before[4])});
    const std::vector<double> after = State(*plant);
    EXPECT_GT(after[2], before[2] + 0.01);
    if (std::abs(lever) > 1e-3) {
      EXPECT_LT((after[4] - before[4]) * lever, 0.0) << lever;
    }
    EXPECT_LT(std::abs(after[4] - before[4]), 40.0 * std::abs(lever) + 1e-9);
  }
}

// The surface stops the peg. The remaining part of a control is the force.
TEST(InsertionTest, PressingHardOnTheSurfaceFailsAndLightlyDoesNot) {
  for (const double press : {0.39, 0.41}) {
    const auto plant = Make(FindGalleryTask("insertion"));
    plant->Reset(1);  // starts far to the left of the slot
    while (State(*plant)[1] > 0.02) Apply(*plant, {0.0, -0.3});
    Apply(*plant, {0.0, -State(*plant)[1] / 0.02});
    ASSERT_NEAR(State(*plant)[1], 0.0, 1e-12);
    ASSERT_FALSE(plant->collided());
    for (int t = 0; t < 5; ++t) Apply(*plant, {0.0, -press});
    EXPECT_NEAR(State(*plant)[1], 0.0, 1e-12);
    EXPECT_EQ(plant->collided(), press > 0.4);
  }
}

TEST(InsertionTest, TheChamferLeadsIntoTheSlotAndItsWallsHoldThePeg) {
  const auto plant = Make(FindGalleryTask("insertion"));
  plant->Reset(2);
  const double slot = State(*plant)[2];
  // Moves the peg to two thirds of the mouth's half width from the middle.
  while (std::abs(State(*plant)[0] - slot + 0.02) > 1e-9) {
    Apply(*plant, {(slot - 0.02 - State(*plant)[0]) / 0.02, 0.0});
  }
  for (int t = 0; t < 200 && !plant->completed(); ++t) Apply(*plant, {0.0, -0.3});
  EXPECT_TRUE(plant->completed());
  EXPECT_NEAR(State(*plant)[0], slot - 0.012, 1e-3);
  for (int t = 0; t < 5; ++t) Apply(*plant, {0.2, 0.0});
  EXPECT_LE(State(*plant)[0], slot + 0.012 + 1e-12);
}

TEST(LidTest, TheHandleSlipsWhenTheGripperLeavesItsCircle) {
  for (const double pull : {0.9, 1.0}) {
    const auto plant = Make(FindGalleryTask("lid"));
    plant->Reset(1);
    Supervise(*plant, [](const std::vector<double>& x) { return x[3] < 0.5; });
    const std::vector<double> x = State(*plant);
    const double r = std::hypot(x[0], x[1]);
    ASSERT_FALSE(plant->collided());
    // Moves to a radius of 0.4 + 0.03 pull + 1 mm.
    const double out = (0.4 + 0.03 * pull + 1e-3 - r) / 0.03;
    for (int t = 0; t < 4; ++t) Apply(*plant, {0.25 * out * x[0] / r, 0.25 * out * x[1] / r, 0.0});
    EXPECT_EQ(plant->collided(), pull == 1.0);
    // The lid has the angle of the gripper before the pull.
    EXPECT_NEAR(State(*plant)[3], std::atan2(x[1], x[0]), 1e-9);
  }
}

// The control changes speeds, and speeds change positions. The effect on positions is therefore one
// step late.
TEST(BalanceTest, AControlMovesPositionsOneStepLater) {
  const auto plant = Make(FindGalleryTask("balance"));
  plant->Reset(1);
  const auto other = plant->Clone();
  Apply(*plant, {1.0});
  Apply(*other, {-1.0});
  const auto a = State(*plant), b = State(*other);
  EXPECT_EQ(a[0], b[0]);
  EXPECT_EQ(a[2], b[2]);
  EXPECT_GT(a[1], b[1]);
  EXPECT_LT(a[3], b[3]);
}

TEST(CarTest, FullForceFromRestDoesNotReachTheTopAndSwingingBackHitsTheWall) {
  const auto plant = Make(FindGalleryTask("car"));
  plant->Reset(1);
  for (int t = 0; t < 100; ++t) Apply(*plant, {1.0});
  EXPECT_FALSE(plant->completed());
  EXPECT_FALSE(plant->collided());
  for (int t = 0; t < 100 && !plant->collided(); ++t) {
    Apply(*plant, {State(*plant)[1] < 0.0 ? -1.0 : 1.0});
    ASSERT_EQ(plant->collided(), State(*plant)[0] < -1.15);
    if (plant->completed()) break;
  }
  EXPECT_TRUE(plant->collided() || plant->completed());
}

// The tip according to Denavit and Hartenberg. Controls turn joints by the task's step.
TEST(ArmTest, TheTipFollowsFromTheJoints) {
  for (const auto& [name, links, step] :
       {std::tuple{"arm2", 2, 0.25}, std::tuple{"arm7", 7, 0.1}}) {
    const auto plant = Make(FindGalleryTask(name));
    core::Random random(2);
    plant->Reset(1);
    for (int t = 0; t < 20; ++t) {
      const auto before = State(*plant);
      std::vector<double> u(static_cast<std::size_t>(links));
      for (double& entry : u) entry = random.Uniform(-1.0, 1.0);
      Apply(*plant, u);
      const auto x = State(*plant);
      double angle = 0.0, tip_x = 0.0, tip_y = 0.0;
      for (std::size_t i = 0; i < u.size(); ++i) {
        ASSERT_NEAR(x[i], before[i] + step * u[i], 1e-12);
        angle += x[i];
        tip_x += std::cos(angle) / links;
        tip_y += std::sin(angle) / links;
      }
      ASSERT_NEAR(x[u.size()], tip_x, 1e-12);
      ASSERT_NEAR(x[u.size() + 1], tip_y, 1e-12);
    }
  }
}

}  // namespace
}  // namespace dfr::sim
