// The task and the camera of line tracking's control loop.
#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <vector>

#include "dfr/dds/channel.h"
#include "robot/image_worker.h"
#include "robot/robot_plant.h"
#include "robot/tool_task.h"
#include "tests/hardware_dvrk/psm_driver_fixture.h"
#include "tests/line_tracking/model_folder.h"
#include "tests/support/eventually.h"

namespace dfr::apps::line_tracking {
namespace {

using runtime::HoldReason;

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

TEST(ImageWorkerTest, OnlyAPictureWithoutAFaultAnswersARequest) {
  dds::Participant network({.domain = test::OwnDomain()});
  RobotConfig config;
  config.image_max_age_s = 1e5;
  const line_task::LineTask task(Data().Calibration(), Base(config));
  const hardware::PsmDriver driver(network, {});
  ImageWorker camera(network, config, driver, task, nullptr, nullptr);
  dds::Participant endoscope({.domain = test::OwnDomain()});
  dds::Publisher<dds::Image> pictures(endoscope, config.camera, dds::Role::kImage);
  test::Eventually([&] { return pictures.num_subscribers() > 0; });
  std::vector<double> state(static_cast<std::size_t>(task.layout().state_dim()));
  // Returns the answer after a picture of this brightness, with this finding.
  const auto answer = [&](std::uint8_t brightness, double ahead_s, HoldReason finding) {
    dds::Image image;
    image.stamp = dds::Stamp::FromNanoseconds(dds::Stamp::Now().nanoseconds() +
                                              static_cast<std::int64_t>(1e9 * ahead_s));
    image.width = static_cast<std::uint32_t>(task.calibration().camera.width);
    image.height = static_cast<std::uint32_t>(task.calibration().camera.height);
    image.encoding = "mono8";
    image.step = image.width;
    image.data.assign(static_cast<std::size_t>(image.step) * image.height, brightness);
    EXPECT_TRUE(pictures.Write(image));
    test::Eventually([&] { return camera.Report().finding.reason == finding; });
    // The next check begins after the picture has been processed.
    const std::int64_t checked_ns = camera.Report().checked_ns;
    test::Eventually([&] { return camera.Report().checked_ns > checked_ns; });
    return camera.Take(state);
  };
  EXPECT_TRUE(camera.Ask(0).ok());
  EXPECT_EQ(answer(100, 3600.0, HoldReason::kClock), robot::Camera::Answer::kPending);
  EXPECT_EQ(answer(0, 0.0, HoldReason::kImageInvalid), robot::Camera::Answer::kPending);
  EXPECT_EQ(answer(120, 0.0, HoldReason::kNone), robot::Camera::Answer::kNotSeen);
}

}  // namespace
}  // namespace dfr::apps::line_tracking
