#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <functional>
#include <limits>
#include <string>

#include "dfr/hardware/psm_client.h"
#include "tests/kinematics/psm_home.h"
#include "tests/support/all_close.h"

namespace dfr::hardware {

/// A client and a console that obeys at once. A step takes 5 ms, and a sample arrives every 10 ms.
/// `spoil` injects a fault into a step's input.
class PsmClientTest : public testing::Test {
 protected:
  using Psm = kinematics::Psm;
  using PsmJoints = kinematics::PsmJoints;

  static constexpr std::int64_t kMs = 1'000'000;
  static constexpr std::int64_t kWall = 1'700'000'000'000'000'000;
  static constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

  static PsmJoints Yaw(double angle) { return test::PsmHomeWith(0, angle); }

  PsmInput Input() {
    PsmInput input;
    input.state_publishers = 1;
    input.command_subscribers = 1;
    input.instrument = PsmInstrument::kSuitable;
    input.pose_controls = stated_poses_ ? 1 : 0;
    input.other_controls = stated_others_ ? 1 : 0;
    if (num_steps_ == 0 || operating_changed_) {
      input.operating_state = operating_;
      operating_changed_ = false;
    }
    if (num_steps_ % 2 == 0) {
      PsmJointSample sample;
      sample.stamp = dds::Stamp::FromNanoseconds(kWall + now_ns_);
      sample.well_formed = sample.has_velocity = true;
      sample.position = at_;
      input.measured_js = input.setpoint_js = sample;
      const Eigen::Isometry3d pose = Psm::Forward(at_);
      input.measured_cp =
          PsmPoseSample{sample.stamp, pose.translation(), Eigen::Quaterniond(pose.linear())};
      if (on_cart_) {
        input.local_measured_cp = input.measured_cp;
        const Eigen::Isometry3d seen = camera_ * pose;
        input.measured_cp =
            PsmPoseSample{sample.stamp, seen.translation(), Eigen::Quaterniond(seen.linear())};
      }
      input.jaw_measured = input.jaw_setpoint = PsmJawSample{sample.stamp, jaw_};
    }
    return input;
  }

  PsmOutput Step(const std::function<void(PsmInput&)>& spoil = {}) {
    PsmInput input = Input();
    if (spoil) spoil(input);
    PsmOutput output = client_.Step(input, now_ns_, kWall + now_ns_);
    ++num_steps_;
    now_ns_ += 5 * kMs;
    if (output.servo) {
      EXPECT_EQ(Psm::Inverse(camera_.inverse() * output.servo_cp, at_), kinematics::PsmReach::kOk);
      ++num_servo_;
    }
    if (output.servo_jaw) jaw_ = output.jaw;
    // The console states each change of control.
    stated_poses_ = output.servo && !obeys_poses_;
    stated_others_ = output.hold && obeys_poses_;
    obeys_poses_ = output.servo || (obeys_poses_ && !output.hold);
    num_holds_ += output.hold;
    if (output.request != PsmRequest::kNone) requests_ += std::string(Name(output.request)) + ' ';
    return output;
  }

  void Steps(int n) {
    for (int i = 0; i < n; ++i) Step();
  }

  void Become(PsmConsoleState state, bool homed, bool busy) {
    operating_.state = state;
    operating_.homed = homed;
    operating_.busy = busy;
    const PsmStatus now = Readiness(operating_);
    if (now != PsmStatus::kOk) {
      ++operating_.lapses;
      operating_.last_lapse = now;
    }
    operating_changed_ = true;
  }

  void ArmNow() {
    Become(PsmConsoleState::kEnabled, true, false);
    Steps(4);
    ASSERT_EQ(client_.Arm(), PsmStatus::kOk) << Name(client_.status());
    Steps(30);
    ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  }

  // Injects `spoil` during a motion: the client holds in exactly the last of `steps` steps (or
  // earlier, if `bound`), sends nothing more, reports the cause, and does not resume after the
  // fault.
  void ExpectHold(PsmStatus cause, const std::function<void(PsmInput&)>& spoil, int steps = 1,
                  bool bound = false) {
    SCOPED_TRACE(Name(cause));
    if (num_steps_ % 2 != 0) Step();  // aligns the samples with the steps
    ArmNow();
    ASSERT_EQ(client_.MoveTo(Yaw(0.2), 3.0), PsmStatus::kOk);
    Steps(41);
    ASSERT_TRUE(client_.moving());
    num_holds_ = 0;
    int taken = 0;
    for (; taken < steps && client_.phase() == PsmPhase::kArmed; ++taken) Step(spoil);
    ASSERT_EQ(client_.phase(), PsmPhase::kHolding) << "after " << steps << " steps";
    EXPECT_TRUE(taken == steps || bound) << "after " << taken << " steps, not " << steps;
    EXPECT_EQ(client_.status(), cause) << Name(client_.status());
    EXPECT_EQ(num_holds_, 1);
    const int sent = num_servo_;
    const PsmJoints there = at_;
    operating_.state = PsmConsoleState::kEnabled;
    Become(PsmConsoleState::kEnabled, true, false);
    Steps(100);
    EXPECT_EQ(client_.phase(), PsmPhase::kHolding);
    EXPECT_EQ(client_.status(), cause);  // the first cause is kept
    EXPECT_EQ(num_servo_, sent);
    EXPECT_EQ(client_.MoveTo(Yaw(0.0), 10.0), PsmStatus::kNotArmed);
    // Only Arm() resumes, from the arm's position.
    ASSERT_EQ(client_.Arm(), PsmStatus::kOk) << Name(client_.hold_reason());
    Steps(2);
    EXPECT_EQ(client_.status(), PsmStatus::kOk);
    EXPECT_TRUE(test::AllClose(client_.setpoint(), there, 1e-9));
  }

  PsmClient client_{PsmClientOptions{}};
  PsmOperatingState operating_;
  bool operating_changed_ = false;
  PsmJoints at_ = test::PsmHome();
  /// If true, the console also publishes local/measured_cp. `camera_` is the arm's base in the
  /// frame of measured_cp.
  bool on_cart_ = false;
  Eigen::Isometry3d camera_ = Eigen::Isometry3d::Identity();
  double jaw_ = 0.1;
  std::int64_t now_ns_ = 1000 * kMs;
  int num_steps_ = 0;
  int num_servo_ = 0;
  int num_holds_ = 0;
  bool obeys_poses_ = false;
  bool stated_poses_ = false;
  bool stated_others_ = false;
  std::string requests_;
};

}  // namespace dfr::hardware
