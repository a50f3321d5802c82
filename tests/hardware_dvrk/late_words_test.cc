// What the console hears of another participant before this client does.
#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <string>
#include <vector>

#include "dfr/hardware/psm_client.h"
#include "dfr/sim/dvrk/psm_console.h"

namespace dfr::hardware {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

constexpr std::int64_t kStepNs = 5'000'000;
constexpr std::int64_t kBeginNs = 1'000'000'000;
constexpr std::int64_t kEpochNs = 1'700'000'000'000'000'000;

PsmJoints Start() {
  PsmJoints q = PsmJoints::Zero();
  q[2] = 0.12;
  return q;
}

// A client at a simulated console, without a network. Steps of 5 ms, a sample with every other.
class LateWordsTest : public testing::Test {
 protected:
  // Both anew, armed and on their way.
  void Begin() {
    console_ = sim::PsmConsole({.arm = "PSM1", .homing_s = 0.2});
    client_ = PsmClient(PsmClientOptions{});
    state_ = {};
    steps_ = moves_ = 0;
    now_ns_ = kBeginNs;
    console_.Place(Start());
    for (int i = 0; i < 10; ++i) Step();
    ASSERT_EQ(client_.Arm(), PsmStatus::kOk) << Name(client_.status());
    for (int i = 0; i < 10; ++i) Step();
    PsmJoints goal = Start();
    goal[0] = 0.4;
    ASSERT_EQ(client_.MoveTo(goal, 4.0), PsmStatus::kOk);
    while (now_ns_ < kBeginNs + 1'000'000'000) Step();
    ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  }

  /// @param newcomers  how many are found in this step.
  /// @param others  carry something out after this client and before the console's own step.
  void Step(int newcomers = 0, const std::function<void()>& others = {}) {
    PsmInput input;
    input.state_publishers = input.command_subscribers = 1;
    input.newcomers = newcomers;
    const bool changed = console_.moves_begun() != moves_ || console_.busy() != state_.busy ||
                         Name(state_.state) != std::string(sim::Name(console_.state()));
    if (steps_ == 0 || changed) {
      state_.busy = console_.busy() || console_.moves_begun() != moves_;
      state_.homed = console_.homed();
      state_.state = console_.state() == sim::ArmState::kEnabled  ? PsmConsoleState::kEnabled
                     : console_.state() == sim::ArmState::kPaused ? PsmConsoleState::kPaused
                                                                  : PsmConsoleState::kDisabled;
      if (const PsmStatus now = Readiness(state_); now != PsmStatus::kOk) {
        ++state_.lapses;
        state_.last_lapse = now;
      }
      moves_ = console_.moves_begun();
      input.operating_state = state_;
    }
    input.goals_reached = static_cast<int>(console_.TakeGoals().size());
    if (steps_ % 2 == 0) {
      const dds::Stamp stamp = dds::Stamp::FromNanoseconds(kEpochNs + now_ns_);
      PsmJointSample sample;
      sample.stamp = stamp;
      sample.well_formed = true;
      sample.position = console_.measured_joints();
      input.measured_js = sample;
      sample.position = console_.setpoint_joints();
      input.setpoint_js = sample;
      const Eigen::Isometry3d pose = console_.measured_pose();
      input.measured_cp =
          PsmPoseSample{stamp, pose.translation(), Eigen::Quaterniond(pose.linear())};
      input.jaw_measured = PsmJawSample{stamp, console_.measured_jaw()};
      input.jaw_setpoint = PsmJawSample{stamp, console_.setpoint_jaw()};
    }
    const PsmOutput output = client_.Step(input, now_ns_, kEpochNs + now_ns_);
    if (output.hold) console_.Hold();
    if (output.servo) console_.ServoCp(output.servo_cp);
    if (output.servo_jaw) console_.ServoJaw(output.jaw);
    if (others) others();
    console_.Step(1e-9 * kStepNs);
    ++steps_;
    now_ns_ += kStepNs;
  }

  [[nodiscard]] Eigen::Vector3d tip() const { return console_.measured_pose().translation(); }

  sim::PsmConsole console_{{.arm = "PSM1", .homing_s = 0.2}};
  PsmClient client_{PsmClientOptions{}};
  PsmOperatingState state_;
  int moves_ = 0;
  int steps_ = 0;
  std::int64_t now_ns_ = kBeginNs;
};

// The participant is found at the latest when the console may first hear it. Its publisher is
// matched here up to half a second later than there, and its only words are never heard.
TEST_F(LateWordsTest, AHoldThatTheConsoleAloneHasHeardHolds) {
  for (int late_ms = 0; late_ms < 500; late_ms += 10) {
    SCOPED_TRACE(late_ms);
    Begin();
    Step(1);
    console_.Hold();
    const Eigen::Vector3d there = tip();
    double motion_m = 0.0;
    for (int ms = 0; ms < 1000; ms += 5) {
      Step(ms == late_ms ? 1 : 0);
      motion_m = std::max(motion_m, (tip() - there).norm());
    }
    EXPECT_EQ(client_.phase(), PsmPhase::kHolding);
    EXPECT_EQ(client_.status(), PsmStatus::kNewcomer) << Name(client_.status());
    EXPECT_LT(motion_m, 1e-3);
  }
}

// Nobody is found before 300 ms after the console has heard it, and what the console publishes is
// all that there is. A hold shows nowhere there, nor does a free.
TEST_F(LateWordsTest, TheConsoleShowsWhatOthersCommand) {
  struct Command {
    const char* topic;
    std::function<void()> carry_out;  // with every third step, out of step with the samples
  };
  const auto near = [](int joint, double by) {
    return [joint, by](PsmJoints q) {
      q[joint] += by;
      return q;
    };
  };
  const auto aside = near(1, 0.03);
  Eigen::Isometry3d turn = Eigen::Isometry3d::Identity();
  turn.translation().x() = 0.003;
  PsmJoints difference = PsmJoints::Zero();
  difference[1] = 0.02;
  const std::vector<Command> commands = {
      {"servo_jp", [&] { console_.ServoJp(aside(console_.setpoint_joints())); }},
      {"servo_cp", [&] { console_.ServoCp(Psm::Forward(aside(console_.setpoint_joints()))); }},
      {"servo_jr", [&] { console_.ServoJr(difference); }},
      {"servo_cr", [&] { console_.ServoCr(turn); }},
      {"move_jp", [&] { console_.MoveJp(aside(console_.setpoint_joints())); }},
      {"move_jr", [&] { console_.MoveJr(difference); }},
      {"move_cp", [&] { console_.MoveCp(Psm::Forward(aside(console_.setpoint_joints()))); }},
      {"jaw/servo_jp", [&] { console_.ServoJaw(0.6); }},
      {"jaw/move_jp", [&] { console_.MoveJaw(0.6); }},
      {"state_command pause", [&] { console_.StateCommand("pause"); }},
      {"state_command disable", [&] { console_.StateCommand("disable"); }}};
  for (const Command& command : commands) {
    SCOPED_TRACE(command.topic);
    Begin();
    int taken = 0;
    for (; taken < 60 && client_.phase() == PsmPhase::kArmed; ++taken) {
      Step(0, taken % 3 == 0 ? command.carry_out : nullptr);
    }
    EXPECT_EQ(client_.phase(), PsmPhase::kHolding) << "after 300 ms";
  }
}

TEST_F(LateWordsTest, NothingIsDetectedWhereNobodyElseIs) {
  Begin();
  for (int i = 0; i < 2000; ++i) Step();
  EXPECT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  EXPECT_TRUE(client_.at_rest());
}

}  // namespace
}  // namespace dfr::hardware
