#include "dfr/hardware/sprk_lag.h"

#include <gtest/gtest.h>

#include "tests/support/all_close.h"

namespace dfr::hardware {
namespace {

kinematics::PlatformPose Pose(double x, double yaw) {
  kinematics::PlatformPose pose;
  pose.translation_m.x() = x;
  pose.angles_rad.z() = yaw;
  return pose;
}

// dx/dt = (c - x) / tau, integrated in small steps. The command changes twice.
TEST(SprkLagTest, SolvesTheLagsEquation) {
  SprkLag lag;
  lag.Rest(Pose(0.0, 0.1), 5.0);
  kinematics::PlatformPose x = Pose(0.0, 0.1);
  constexpr double kStep = 1e-5;
  double time_s = 5.0;
  for (const auto& command : {Pose(0.01, -0.1), Pose(-0.002, 0.0), Pose(0.003, 0.2)}) {
    lag.Command(command, time_s);
    for (int i = 0; i < 15000; ++i) {
      x.translation_m += kStep / 0.2 * (command.translation_m - x.translation_m);
      x.angles_rad += kStep / 0.2 * (command.angles_rad - x.angles_rad);
    }
    time_s += 0.15;
    // The error of Euler's method is at most tau / 2 times its step times the second derivative,
    // which is at most 0.3 rad / tau^2.
    EXPECT_TRUE(test::AllClose(lag.At(time_s).translation_m, x.translation_m, 1e-5));
    EXPECT_TRUE(test::AllClose(lag.At(time_s).angles_rad, x.angles_rad, 1e-4));
  }
}

}  // namespace
}  // namespace dfr::hardware
