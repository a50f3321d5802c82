#include "robot/tool_task.h"

#include <gtest/gtest.h>

#include <array>

#include "tests/hardware_dvrk/psm_driver_fixture.h"

namespace dfr::apps::line_tracking {
namespace {

class ToolTaskTest : public hardware::PsmDriverTest {};

// An upright tool has joints that differ from the task's by rounding.
TEST_F(ToolTaskTest, AFirstControlOfZeroIsNotTooFast) {
  Eigen::Isometry3d p_world_base = Eigen::Isometry3d::Identity();
  p_world_base.translation() = -kinematics::Psm::Tip(test::PsmHome());
  const line_task::LineTask task({}, p_world_base);
  kinematics::PsmJoints near = test::PsmHome();
  near[4] = 5e-7;
  console_.Place(near);
  const auto driver = Connected();
  Until(*driver, [&] { return driver->Arm() == hardware::PsmStatus::kOk; });
  ToolTask tool(task, *driver, 0.01);
  tool.Begin();
  for (int control = 0; control < 2; ++control) {
    const std::optional<robot::Motion> motion = tool.Plan(std::array{0.0, 0.0});
    ASSERT_TRUE(motion);
    EXPECT_LE(motion->duration_s, 0.005);
    const kinematics::PsmJoints goal(
        Eigen::Map<const kinematics::PsmJoints>(motion->joints.data()));
    EXPECT_NE(goal, near);
    ASSERT_EQ(driver->MoveTo(goal, motion->duration_s), hardware::PsmStatus::kOk);
    Until(*driver, [&] { return !driver->moving(); });
  }
}

}  // namespace
}  // namespace dfr::apps::line_tracking
