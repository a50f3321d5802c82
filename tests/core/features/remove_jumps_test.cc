#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "dfr/core/features/rotations.h"
#include "dfr/core/random.h"

namespace dfr::core {
namespace {

// Column 0 moves at random. Column 1 is an angle that makes two revolutions and returns. Columns 2
// to 5 are a quaternion about z.
Trajectory Turned(Random& random) {
  constexpr int kSteps = 60;
  Trajectory turned;
  turned.states.resize(kSteps + 1, 6);
  for (int t = 0; t <= kSteps; ++t) {
    const double angle = 4.0 * std::numbers::pi * std::sin(0.05 * t) + 0.1 * random.Normal();
    turned.states.row(t) << random.Normal(), angle, std::cos(0.02 * t), 0.0, 0.0,
        std::sin(0.02 * t);
  }
  return turned;
}

TEST(RemoveJumpsTest, RevolutionsAndSignsAreContinuous) {
  for (const double period : {2.0 * std::numbers::pi, 360.0}) {
    Random random(3);
    StateLayout layout;
    layout.Add("position", 1);
    layout.Add("angle", 1);
    layout.Add("quat", 4);
    std::vector<Trajectory> plain;
    for (int i = 0; i < 10; ++i) {
      plain.push_back(Turned(random));
      plain.back().states.col(1) *= period / (2.0 * std::numbers::pi);
    }
    std::vector<Trajectory> jumping = plain;
    for (Trajectory& d : jumping) {
      d.states.col(1) = d.states.col(1)
                            .unaryExpr([&](double angle) { return std::remainder(angle, period); })
                            .eval();
      for (Eigen::Index t = 0; t < d.states.rows(); ++t) {
        if (random.Uniform() < 0.5) d.states.row(t).tail(4) *= -1.0;
      }
    }
    const std::vector<Rotation> rotations = FindRotations(layout, jumping);
    ASSERT_EQ(rotations.size(), 2u);
    for (std::size_t i = 0; i < plain.size(); ++i) {
      Matrix states = jumping[i].states;
      RemoveJumps(rotations, states);
      EXPECT_EQ(states.row(0), jumping[i].states.row(0));
      EXPECT_EQ(states.col(0), plain[i].states.col(0));
      EXPECT_LE((states.col(1) - plain[i].states.col(1)).cwiseAbs().maxCoeff(), 1e-12 * period);
      const double sign = states(0, 2) > 0.0 ? 1.0 : -1.0;
      EXPECT_EQ(states.rightCols(4), sign * plain[i].states.rightCols(4));
      // Continuous states stay unchanged to the bit.
      Matrix same = plain[i].states;
      RemoveJumps(rotations, same);
      EXPECT_EQ(same, plain[i].states);
    }
  }
}

}  // namespace
}  // namespace dfr::core
