#include "apps/planar_page/world.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <vector>

namespace dfr::apps::planar_page {
namespace {

constexpr std::size_t kTwoWays = 0, kGap = 1, kCorridor = 2, kOwn = 3;
constexpr std::size_t kAlone = 0, kEarlyStopping = 1, kGuided = 3, kCertifiedMethod = 4;

std::string Refusal(World& world, const std::vector<Point>& line) {
  try {
    world.Draw(line, 3, 1);
  } catch (const std::invalid_argument& e) {
    return e.what();
  }
  return "";
}

TEST(PointPlantTest, ControlForIsTheInverseOfDisplacementWithinItsReach) {
  const Point moved = Displacement(ControlFor({0.03, -0.05}));
  EXPECT_NEAR(moved[0], 0.03, 1e-15);
  EXPECT_NEAR(moved[1], -0.05, 1e-15);
  // Each entry of a control saturates.
  EXPECT_NEAR(std::hypot(Displacement({100.0, 0.0})[0], Displacement({100.0, 0.0})[1]),
              PointPlant::kGain, 1e-15);
}

TEST(PointPlantTest, CrossingAnObstacleCollides) {
  PointPlant plant(Scenes()[kGap]);
  plant.MoveTo({1.69, 0.0});
  EXPECT_FALSE(plant.collided());
  EXPECT_EQ(plant.Apply(ControlFor({0.05, 0.0})), core::PlantStatus::kOk);
  EXPECT_TRUE(plant.collided());
  // The outcome is reset if the user moves the robot, and only then.
  EXPECT_EQ(plant.Apply(ControlFor({-0.05, 0.0})), core::PlantStatus::kOk);
  EXPECT_TRUE(plant.collided());
  plant.MoveTo({0.0, 0.0});
  EXPECT_FALSE(plant.collided());
}

TEST(WorldTest, DemonstrationsOfEverySceneReachTheGoalAndTouchNothing) {
  for (std::size_t scene : {kTwoWays, kGap, kCorridor}) {
    SCOPED_TRACE(Scenes()[scene].name);
    World world(scene);
    world.Demonstrate(20, 3);
    ASSERT_EQ(world.demonstrations().size(), 20u);
    const Disc& goal = world.scene().goal;
    for (const core::Trajectory& d : world.demonstrations()) {
      for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
        ASSERT_GE(world.plant().Clearance({d.states(t, 0), d.states(t, 1)}), 0.0);
      }
      const Eigen::Index last = d.states.rows() - 1;
      EXPECT_LE(std::hypot(d.states(last, 0) - goal.centre[0], d.states(last, 1) - goal.centre[1]),
                goal.radius);
    }
  }
}

// Statements of the page about its scenes: the policy alone fails often, and guided recovery
// rarely.
TEST(WorldTest, GuidedRecoveryCompletesWhatThePolicyAloneDoesNot) {
  for (std::size_t scene : {kTwoWays, kGap, kCorridor}) {
    SCOPED_TRACE(Scenes()[scene].name);
    World world(scene);
    world.Demonstrate(60, 1);
    world.Fit();
    const Tally alone = world.Run(kAlone, 30, 7);
    const Tally guided = world.Run(kGuided, 30, 7);
    EXPECT_GE(alone.collided, 3);
    EXPECT_GE(guided.completed, 27);
    EXPECT_EQ(guided.collided, 0);
    EXPECT_EQ(guided.completed + guided.halted + guided.collided, 30);
    EXPECT_EQ(world.Run(kEarlyStopping, 10, 7).completed, 0);
  }
}

TEST(WorldTest, CertifiedEpisodesStayInsideUnderAnyPush) {
  World world(kTwoWays);
  world.Demonstrate(60, 1);
  world.Fit();
  EXPECT_FALSE(world.fitted_certified());
  world.FitCertified();
  EXPECT_TRUE(world.fitted_certified());
  const Point start = world.scene().start.centre;
  const SafeRegion region = world.Certified(0, start);
  ASSERT_GT(region.radius, 0.0);
  for (int i = 0; i < 360; ++i) {
    const double angle = i * M_PI / 180.0;
    const Point edge = {region.centre[0] + region.radius * std::cos(angle),
                        region.centre[1] + region.radius * std::sin(angle)};
    EXPECT_GE(world.LogDecision(Support::kCertified, 0, edge), -1e-9);
  }
  for (const Point& push : {Point{0.1, 0.0}, Point{-0.1, -0.1}}) {
    world.Push(push);
    Episode episode = world.Start(kCertifiedMethod, start, 0, 1);
    int certified = 0;
    while (!episode.over()) {
      const Decision d = episode.Step();
      if (!d.step.certified) continue;
      ++certified;
      double most = -1.0;
      for (int t = d.step.t - 3; t <= d.step.t + 3; ++t) {
        most = std::max(most, world.LogDecision(Support::kCertified, t, d.to));
      }
      ASSERT_GE(most, 0.0) << "at t = " << d.step.t;
    }
    EXPECT_GT(certified, 10);
  }
}

TEST(WorldTest, ADrawnLineIsADemonstrationAndARefusedOneLosesNothing) {
  World world(kOwn);
  std::vector<Point> line;
  for (int i = 0; i <= 40; ++i) line.push_back({0.1 * i, 0.6 * std::sin(M_PI * i / 20.0)});
  world.Draw(line, 7, 5);
  ASSERT_EQ(world.demonstrations().size(), 8u);
  // The first demonstration is the line itself.
  const core::Matrix& states = world.demonstrations()[0].states;
  for (Eigen::Index t = 3; t < states.rows(); ++t) {
    EXPECT_NEAR(states(t, 1), 0.6 * std::sin(M_PI * states(t, 0) / 2.0), 0.04) << t;
  }
  EXPECT_EQ(Refusal(world, {{1.0, 0.0}, {4.0, 0.0}}), "Begin the line at the start.");
  EXPECT_EQ(Refusal(world, {{0.0, 0.0}, {2.0, 0.0}}), "End the line at the goal.");
  EXPECT_EQ(Refusal(world, {{0.0, 0.0}}), "Draw a line from the start to the goal.");
  EXPECT_EQ(world.demonstrations().size(), 8u);
  World gap(kGap);
  EXPECT_EQ(Refusal(gap, {{0.0, 0.0}, {4.0, 0.0}}),
            "The line touches an obstacle: draw one that does not.");
  EXPECT_TRUE(gap.demonstrations().empty());
}

TEST(WorldTest, TooFewDemonstrationsAreRefused) {
  World world(kTwoWays);
  world.Demonstrate(2, 1);
  EXPECT_THROW(world.Fit(), std::invalid_argument);
  EXPECT_FALSE(world.fitted());
  World own(kOwn);
  EXPECT_THROW(own.Demonstrate(3, 1), std::invalid_argument);
}

}  // namespace
}  // namespace dfr::apps::planar_page
