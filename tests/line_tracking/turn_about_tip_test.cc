#include "robot/turn_about_tip.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "dfr/core/random.h"
#include "tests/kinematics/psm_home.h"

namespace dfr::apps::line_tracking {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

// Sets `upright` to joints with an upright tool and the tips at their positions in `from`.
bool UprightAt(const PsmJoints& from, PsmJoints& upright) {
  Eigen::Isometry3d pose = Psm::Forward(test::PsmHome());
  pose.translation() = Psm::Tip(from) - Psm::kJawLength * pose.linear().col(2);
  return Psm::Inverse(pose, upright) == kinematics::PsmReach::kOk;
}

// Largest distance of the tips from their start, in total and downwards, over moves in joint space.
struct Way {
  double astray_m = 0.0;
  double down_m = 0.0;
};
Way Follow(const PsmJoints& from, const std::vector<PsmJoints>& way) {
  Way worst;
  PsmJoints before = from;
  const Eigen::Vector3d place = Psm::Tip(from);
  for (const PsmJoints& goal : way) {
    for (int i = 0; i <= 50; ++i) {
      const Eigen::Vector3d off = Psm::Tip(before + i / 50.0 * (goal - before)) - place;
      worst.astray_m = std::max(worst.astray_m, off.norm());
      worst.down_m = std::max(worst.down_m, -off.z());
    }
    before = goal;
  }
  return worst;
}

TEST(TurnAboutTipTest, TheTipsStayInPlaceWhereOneMoveWouldLowerThem) {
  core::Random random(3);
  int turned = 0;
  double worst_of_one_move = 0.0;
  for (int n = 0; n < 200; ++n) {
    PsmJoints from;
    from << random.Uniform(-0.2, 0.2), random.Uniform(-0.2, 0.2), random.Uniform(0.1, 0.14),
        random.Uniform(-1.0, 1.0), random.Uniform(-1.0, 1.0), random.Uniform(-1.0, 1.0);
    PsmJoints upright;
    if (!UprightAt(from, upright)) continue;
    worst_of_one_move = std::max(worst_of_one_move, Follow(from, {upright}).down_m);
    const auto way = TurnAboutTip(from, upright);
    if (!way) continue;
    ++turned;
    EXPECT_EQ(way->back(), upright);
    EXPECT_LT(Follow(from, *way).astray_m, kMostAstray) << from.transpose();
  }
  EXPECT_GT(turned, 180);
  EXPECT_GT(worst_of_one_move, 0.003) << "one move would not suffice";
}

TEST(TurnAboutTipTest, WithoutATurnThePathIsOneMove) {
  const auto way = TurnAboutTip(test::PsmHome(), test::PsmHome());
  ASSERT_TRUE(way);
  EXPECT_EQ(way->size(), 1U);
}

TEST(TurnAboutTipTest, FindsNoPathBeyondTheJointLimits) {
  PsmJoints from;
  from << 0.0, 0.0, 0.12, 3.0, 1.2, 1.2;
  PsmJoints to;
  to << 0.0, 0.0, 0.12, -3.0, -1.2, -1.2;
  EXPECT_FALSE(TurnAboutTip(from, to));
}

}  // namespace
}  // namespace dfr::apps::line_tracking
