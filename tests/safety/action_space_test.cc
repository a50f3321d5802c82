#include "dfr/safety/action_space.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "dfr/core/random.h"

namespace dfr::safety {
namespace {

// A gripper carries an object along x. State: x, opening of the gripper, x of the object. Action:
// the change of x, from `speeds`, and the command that opens or closes the gripper within a few
// steps.
std::vector<core::Trajectory> Carried(const std::vector<double>& speeds) {
  constexpr int kSteps = 40;
  core::Random random(4);
  std::vector<core::Trajectory> demonstrations(20);
  for (core::Trajectory& d : demonstrations) {
    d.states.resize(kSteps + 1, 3);
    d.controls.resize(kSteps, 2);
    const double start = 0.1 * random.Normal();
    d.states.row(0) << start, 1.0, start;
    const int closes = 8 + static_cast<int>(4.0 * random.Uniform());
    for (int t = 0; t < kSteps; ++t) {
      const auto choice =
          static_cast<std::size_t>(random.Uniform() * static_cast<double>(speeds.size()));
      const bool moves = t > closes + 4 && t < 35;
      const double speed = moves ? speeds[std::min(choice, speeds.size() - 1)] : 0.0;
      const double command = t >= closes && t < 36 ? -1.0 : 1.0;
      d.controls.row(t) << speed, command;
      const double opening = std::clamp(d.states(t, 1) + 0.25 * command, 0.0, 1.0);
      const double x = d.states(t, 0) + speed + 0.002 * random.Normal();
      d.states.row(t + 1) << x, opening, opening < 0.5 ? x : d.states(t, 2);
    }
  }
  return demonstrations;
}

TEST(ActionSpaceTest, AnAxisWithFewSpeedsIsSteeredAndAGripperIsNot) {
  for (const std::vector<double>& speeds :
       {std::vector{0.04}, std::vector{0.0, 0.04}, std::vector{-0.04, 0.04, 0.08}}) {
    const ActionSpace space(Carried(speeds));
    EXPECT_TRUE(space.entries()[0].steered);
    EXPECT_FALSE(space.entries()[1].steered);
    EXPECT_EQ(space.steered_dim(), 1);
  }
}

// The axis does not change the state. The fit cannot distinguish it from a gripper.
TEST(ActionSpaceTest, AnEntryWithoutAnEffectOnTheStateIsNotSteeredIfAnotherIs) {
  auto demonstrations = Carried({0.0, 0.04});
  core::Random random(1);
  for (core::Trajectory& d : demonstrations) {
    core::Matrix controls(d.controls.rows(), 3);
    controls.leftCols(2) = d.controls;
    d.states.resize(d.states.rows(), 1);
    d.states(0, 0) = 0.0;
    for (Eigen::Index t = 0; t < controls.rows(); ++t) {
      controls(t, 2) = random.Normal();
      d.states(t + 1, 0) = d.states(t, 0) + controls(t, 2);
    }
    d.controls = controls;
  }
  const ActionSpace space(demonstrations);
  EXPECT_FALSE(space.entries()[0].steered);
  EXPECT_FALSE(space.entries()[1].steered);
  EXPECT_TRUE(space.entries()[2].steered);
  // Without the third entry, only entries without an effect remain.
  for (core::Trajectory& d : demonstrations) d.controls = core::Matrix(d.controls.leftCols(2));
  EXPECT_EQ(ActionSpace(demonstrations).steered_dim(), 2);
}

}  // namespace
}  // namespace dfr::safety
