#include <gtest/gtest.h>

#include <functional>

#include "dfr/hardware/psm_client.h"
#include "tests/hardware_dvrk/psm_client_fixture.h"
#include "tests/support/all_close.h"

namespace dfr::hardware {
namespace {

// On a cart with setup joints and an endoscope arm, poses are relative to the camera.
class PsmClientOnCartTest : public PsmClientTest {
 protected:
  void SetUp() override {
    Eigen::Isometry3d base = Eigen::Isometry3d::Identity();
    base.translation() = Eigen::Vector3d(0.1, -0.2, 0.3);
    base.linear() = (Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitX()) *
                     Eigen::AngleAxisd(-1.9, Eigen::Vector3d::UnitZ()))
                        .toRotationMatrix();
    camera_ = base;
    on_cart_ = true;
  }
  // Returns a change of the input as if the camera had moved by `distance_m`.
  static std::function<void(PsmInput&)> CameraMoved(double distance_m) {
    return [distance_m](PsmInput& input) {
      if (input.measured_cp) input.measured_cp->position_m.x() += distance_m;
    };
  }
};

TEST_F(PsmClientOnCartTest, HoldsWhenTheCameraMoves) {
  ExpectHold(PsmStatus::kBaseMoved, CameraMoved(0.003), 2, true);
}

TEST_F(PsmClientOnCartTest, AVibratingCameraDoesNotHold) {
  ArmNow();
  for (int i = 0; i < 100; ++i) Step(CameraMoved(i % 4 < 2 ? 0.001 : -0.001));
  EXPECT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
}

TEST_F(PsmClientOnCartTest, HoldsWhenItsOwnFrameIsSilent) {
  ExpectHold(
      PsmStatus::kStateSilent, [](PsmInput& input) { input.local_measured_cp.reset(); }, 12, true);
}

// Poses of different moments do not give the arm's base: its motion would remain unnoticed.
TEST_F(PsmClientOnCartTest, HoldsWhenItsPosesAreOfDifferentMoments) {
  const auto spoil = [](PsmInput& input) {
    if (!input.local_measured_cp) return;
    input.local_measured_cp->stamp =
        dds::Stamp::FromNanoseconds(input.local_measured_cp->stamp.nanoseconds() - 4 * kMs);
    CameraMoved(0.003)(input);
  };
  ExpectHold(PsmStatus::kStateSilent, spoil, 12, true);
}

TEST_F(PsmClientOnCartTest, IsNotArmedOnAnOldBase) {
  Become(PsmConsoleState::kEnabled, true, false);
  Steps(4);
  for (int i = 0; i < 12; ++i) {
    Step([](PsmInput& input) {
      if (!input.local_measured_cp) return;
      input.local_measured_cp->stamp =
          dds::Stamp::FromNanoseconds(input.local_measured_cp->stamp.nanoseconds() - 4 * kMs);
      CameraMoved(0.1)(input);
    });
  }
  EXPECT_EQ(client_.Arm(), PsmStatus::kStateSilent);
}

TEST_F(PsmClientOnCartTest, IsNotArmedWithAnotherInstrument) {
  Become(PsmConsoleState::kEnabled, true, false);
  for (int i = 0; i < 4; ++i) {
    Step([](PsmInput& input) {
      if (input.local_measured_cp) input.local_measured_cp->position_m.z() -= 0.005;
    });
  }
  EXPECT_EQ(client_.Arm(), PsmStatus::kFrameMismatch);
}

// The twist is the derivative of the pose: the difference of two poses sent 5 ms apart.
TEST_F(PsmClientOnCartTest, TwistIsThatOfTheSetpoints) {
  ArmNow();
  PsmJoints goal = Yaw(0.2);
  goal[3] = 0.3;
  ASSERT_EQ(client_.MoveTo(goal, 3.0), PsmStatus::kOk);
  Steps(300);
  const PsmOutput a = Step();
  const PsmOutput b = Step();
  const PsmOutput c = Step();
  ASSERT_TRUE(a.servo && b.servo && c.servo);
  constexpr double kTwoSteps = 0.01;
  EXPECT_TRUE(test::AllClose(
      b.twist.head<3>(), (c.servo_cp.translation() - a.servo_cp.translation()) / kTwoSteps, 1e-6));
  const Eigen::AngleAxisd turn(c.servo_cp.linear() * a.servo_cp.linear().transpose());
  EXPECT_TRUE(test::AllClose(b.twist.tail<3>(), turn.angle() / kTwoSteps * turn.axis(), 1e-5));
  EXPECT_GT(b.twist.norm(), 0.05);
  Steps(700);
  EXPECT_EQ(Step().twist, (Eigen::Matrix<double, 6, 1>::Zero()));
}

}  // namespace
}  // namespace dfr::hardware
