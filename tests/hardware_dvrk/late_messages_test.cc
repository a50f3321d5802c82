// Messages of another participant that reach the console before this client.
#include <gtest/gtest.h>

#include <algorithm>
#include <deque>
#include <functional>
#include <vector>

#include "dfr/hardware/control_statement.h"
#include "dfr/hardware/psm_client.h"
#include "dfr/sim/dvrk/psm_console.h"
#include "tests/hardware_dvrk/console_topics.h"
#include "tests/kinematics/psm_home.h"

namespace dfr::hardware {
namespace {

using kinematics::Psm;
using kinematics::PsmJoints;

constexpr std::int64_t kStepNs = 5'000'000;
constexpr std::int64_t kBeginNs = 1'000'000'000;
constexpr std::int64_t kEpochNs = 1'700'000'000'000'000'000;
constexpr int kTransitSteps = 3;  // default transit time of the console's texts, in steps

struct Command {
  const char* topic;
  std::function<void()> carry_out;
  PsmStatus reason = PsmStatus::kForeignControl;
};

// A client connected to a simulated console, without a network. A step takes 5 ms, and every second
// step has a sample.
class LateMessagesTest : public testing::Test {
 protected:
  // Recreates client and console, armed and in motion.
  void Begin() {
    console_ = sim::PsmConsole({.arm = "PSM1", .homing_s = 0.2});
    client_ = PsmClient(PsmClientOptions{});
    topics_ = {};
    texts_.clear();
    steps_ = 0;
    deaf_ = deaf_to_holds_ = false;
    now_ns_ = kBeginNs;
    console_.Place(test::PsmHome());
    for (int i = 0; i < 10; ++i) Step();
    ASSERT_EQ(client_.Arm(), PsmStatus::kOk) << Name(client_.status());
    for (int i = 0; i < 10; ++i) Step();
    ASSERT_EQ(client_.MoveTo(test::PsmHomeWith(0, 0.4), 4.0), PsmStatus::kOk);
    while (now_ns_ < kBeginNs + 1'000'000'000) Step();
    ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  }

  /// @param newcomers  number of participants found in this step.
  /// @param others  runs after this client and before the console's step.
  void Step(int newcomers = 0, const std::function<void()>& others = {}) {
    PsmInput input;
    input.state_publishers = input.command_subscribers = 1;
    input.instrument = PsmInstrument::kSuitable;
    input.newcomers = newcomers;
    topics_.ReadState(console_, input);
    input.goals_reached = static_cast<int>(console_.TakeGoals().size());
    for (; !texts_.empty() && texts_.front().due <= steps_; texts_.pop_front()) {
      input.pose_controls += texts_.front().control == PsmControl::kPoses ? 1 : 0;
      input.other_controls += texts_.front().control == PsmControl::kOther ? 1 : 0;
      input.errors += texts_.front().is_error ? 1 : 0;
    }
    if (steps_ % 2 == 0) topics_.Measure(console_, kEpochNs + now_ns_, input);
    const PsmOutput output = client_.Step(input, now_ns_, kEpochNs + now_ns_);
    if (output.hold && !deaf_to_holds_) console_.Hold();
    if (output.servo && !deaf_) console_.ServoCp(output.servo_cp);
    if (output.servo_jaw && !deaf_) console_.ServoJaw(output.jaw);
    if (others) others();
    console_.Step(1e-9 * kStepNs);
    for (const sim::ConsoleMessage& message : console_.TakeMessages()) {
      texts_.push_back({steps_ + transit_steps_, ControlStatedBy(message.text),
                        message.severity == sim::ConsoleMessage::Severity::kError});
    }
    ++steps_;
    now_ns_ += kStepNs;
  }

  // Returns the largest motion, in m, after a command that only the console receives. The client
  // discovers the sender after `late_ms`.
  double MotionAfter(const std::function<void()>& command, int times, int late_ms) {
    Begin();
    const Eigen::Vector3d there = tip();
    double motion_m = 0.0;
    for (int ms = 0; ms < 1000; ms += 5) {
      const bool now = ms % 50 == 0 && ms / 50 < times;
      Step(ms == late_ms ? 1 : 0, now ? command : nullptr);
      motion_m = std::max(motion_m, (tip() - there).norm());
    }
    return motion_m;
  }

  // Only the console receives a hold. Its answer takes up to `steps` steps.
  void ExpectAForeignHoldIsDetected(int steps = kTransitSteps) {
    Step(0, [&] { console_.Hold(); });
    for (int i = 0; i <= steps; ++i) Step();
    EXPECT_EQ(client_.status(), PsmStatus::kForeignControl) << Name(client_.status());
  }

  [[nodiscard]] Eigen::Vector3d tip() const { return console_.measured_pose().translation(); }

  sim::PsmConsole console_{{.arm = "PSM1", .homing_s = 0.2}};
  PsmClient client_{PsmClientOptions{}};
  test::ConsoleTopics topics_;
  struct Text {
    int due;
    PsmControl control;
    bool is_error;
  };
  std::deque<Text> texts_;  // in transit
  bool deaf_ = false;       // true: our commands are lost
  bool deaf_to_holds_ = false;
  int transit_steps_ = kTransitSteps;
  int steps_ = 0;
  std::int64_t now_ns_ = kBeginNs;
};

// A hold is sent once, or 20 times a second for .3 s. The client finds the sender up to half a
// second later than the console does.
TEST_F(LateMessagesTest, AHoldThatOnlyTheConsoleReceivesHolds) {
  for (const int late_ms : {0, 10, 20, 50, 100, 200, 490}) {
    for (const int times : {1, 6}) {
      SCOPED_TRACE(testing::Message() << times << " times, found after " << late_ms << " ms");
      EXPECT_LT(MotionAfter([&] { console_.Hold(); }, times, late_ms), 1e-3);
      EXPECT_EQ(client_.phase(), PsmPhase::kHolding);
      EXPECT_EQ(client_.status(),
                late_ms <= 5 * kTransitSteps ? PsmStatus::kNewcomer : PsmStatus::kForeignControl)
          << Name(client_.status());
    }
  }
}

// The sender is discovered 300 ms after the command. Until then, only the console's messages reveal
// the command. OneCommandIsEnough tests commands that are not repeated.
TEST_F(LateMessagesTest, TheConsoleRevealsForeignCommands) {
  const auto aside = [](PsmJoints q) {
    q[1] += 0.03;
    return q;
  };
  Eigen::Isometry3d turn = Eigen::Isometry3d::Identity();
  turn.translation().x() = 0.003;
  const std::vector<Command> commands = {
      {"servo_cp", [&] { console_.ServoCp(Psm::Forward(aside(console_.setpoint_joints()))); }},
      {"servo_cr", [&] { console_.ServoCr(turn); }},
      {"jaw/servo_jp", [&] { console_.ServoJaw(0.6); }},
      {"state_command pause", [&] { console_.StateCommand("pause"); }},
      {"state_command disable", [&] { console_.StateCommand("disable"); }}};
  for (const Command& command : commands) {
    SCOPED_TRACE(command.topic);
    Begin();
    int taken = 0;
    for (; taken < 60 && client_.phase() == PsmPhase::kArmed; ++taken) {
      // The commands are not synchronous with the samples.
      Step(0, taken % 3 == 0 ? command.carry_out : nullptr);
    }
    EXPECT_EQ(client_.phase(), PsmPhase::kHolding) << "after 300 ms";
  }
}

// The console executes each command once, without repetition, and the client finds the sender 300
// ms later. A move makes the arm busy before the text arrives.
TEST_F(LateMessagesTest, OneCommandIsEnough) {
  const std::vector<Command> commands = {
      {"hold", [&] { console_.Hold(); }},
      {"free", [&] { console_.Free(); }},
      {"servo_jp", [&] { console_.ServoJp(console_.setpoint_joints()); }},
      {"servo_jr", [&] { console_.ServoJr(PsmJoints::Zero()); }},
      {"servo_jf", [&] { console_.ServoEffort("servo_jf"); }},
      {"jaw/servo_jf", [&] { console_.ServoEffort("jaw/servo_jf"); }},
      {"body/servo_cf", [&] { console_.ServoEffort("body/servo_cf"); }},
      {"spatial/servo_cf", [&] { console_.ServoEffort("spatial/servo_cf"); }},
      {"move_jp", [&] { console_.MoveJp(console_.setpoint_joints()); }, PsmStatus::kBusy},
      {"move_jr", [&] { console_.MoveJr(PsmJoints::Zero()); }, PsmStatus::kBusy},
      {"move_cp", [&] { console_.MoveCp(console_.setpoint_pose()); }, PsmStatus::kBusy},
      {"jaw/move_jp", [&] { console_.MoveJaw(console_.setpoint_jaw()); }, PsmStatus::kBusy}};
  for (const Command& command : commands) {
    SCOPED_TRACE(command.topic);
    EXPECT_LT(MotionAfter(command.carry_out, 1, 300), 1e-3);
    EXPECT_EQ(client_.phase(), PsmPhase::kHolding);
    EXPECT_EQ(client_.status(), command.reason) << Name(client_.status());
  }
}

// The console answers our hold, and the first set-point after it, only when the arm is armed again.
TEST_F(LateMessagesTest, AnswersToOurOwnCommandsDoNotHold) {
  Begin();
  for (int episode = 0; episode < 20; ++episode) {
    SCOPED_TRACE(episode);
    client_.Hold();
    Step();
    ASSERT_EQ(client_.phase(), PsmPhase::kHolding);
    ASSERT_EQ(client_.Arm(), PsmStatus::kOk) << Name(client_.status());
    PsmJoints goal = client_.setpoint();
    goal[0] += episode % 2 == 0 ? 0.02 : -0.02;
    ASSERT_EQ(client_.MoveTo(goal, 1.0), PsmStatus::kOk);
    ASSERT_EQ(client_.MoveJaw(episode % 2 == 0 ? 0.2 : 0.0, 1.0), PsmStatus::kOk);
    for (int i = 0; i < 300; ++i) Step();
    ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  }
  ExpectAForeignHoldIsDetected();
}

// The texts arrive up to 0.9 s late: after the arm has been armed again, even several times. Once
// all have arrived, another participant's hold is detected.
TEST_F(LateMessagesTest, LateAnswersToOurOwnCommandsDoNotHold) {
  for (const int transit_steps : {20, 60, 180}) {
    for (const int phase_steps : {10, 25, 100}) {
      SCOPED_TRACE(testing::Message() << transit_steps << " late, " << phase_steps << " armed");
      transit_steps_ = kTransitSteps;
      Begin();
      transit_steps_ = transit_steps;
      for (int phase = 0; phase < 10; ++phase) {
        client_.Hold();
        Step();
        ASSERT_EQ(client_.Arm(), PsmStatus::kOk) << Name(client_.status());
        ASSERT_EQ(client_.MoveJaw(phase % 2 == 0 ? 0.02 : 0.0, 0.1), PsmStatus::kOk);
        for (int i = 0; i < phase_steps; ++i) Step();
        ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
      }
      for (int i = 0; i < transit_steps; ++i) Step();
      ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
      ExpectAForeignHoldIsDetected(transit_steps);
    }
  }
}

// The foreign hold arrives at or after the first set-point, which is sent as soon as the answer to
// our own hold has arrived.
TEST_F(LateMessagesTest, AForeignHoldRightAfterOurOwnIsDetected) {
  for (int steps = kTransitSteps - 1; steps < 40; ++steps) {
    SCOPED_TRACE(steps);
    Begin();
    client_.Hold();
    Step();
    ASSERT_EQ(client_.Arm(), PsmStatus::kOk) << Name(client_.status());
    for (int i = 0; i < steps; ++i) Step();
    ExpectAForeignHoldIsDetected(2 * kTransitSteps);
  }
}

// The console never answers our own hold, because the hold was lost: poses still control the
// console. The client waits a second for the answer before it sends a set-point. A later foreign
// hold does not count as the answer.
TEST_F(LateMessagesTest, AForeignHoldAfterAnUnansweredOwnHoldIsDetected) {
  for (int ms = 0; ms < 2000; ms += 250) {
    SCOPED_TRACE(testing::Message() << ms << " ms after our own hold");
    Begin();
    deaf_to_holds_ = true;
    client_.Hold();
    Step();
    deaf_to_holds_ = false;
    ASSERT_EQ(client_.Arm(), PsmStatus::kOk) << Name(client_.status());
    ASSERT_EQ(client_.MoveTo(test::PsmHomeWith(0, 0.4), 4.0), PsmStatus::kOk);
    const Eigen::Vector3d before = tip();
    for (int i = 0; i < ms; i += 5) Step();
    const Eigen::Vector3d there = tip();
    Step(0, [&] { console_.Hold(); });
    if (ms <= 1000) {
      // No set-point was sent, so the arm stands still.
      EXPECT_LT((there - before).norm(), 1e-3);
      continue;
    }
    double motion_m = 0.0;
    for (int i = 0; i < 200; ++i) {
      Step();
      motion_m = std::max(motion_m, (tip() - there).norm());
    }
    EXPECT_EQ(client_.status(), PsmStatus::kForeignControl) << Name(client_.status());
    EXPECT_LT(motion_m, 1e-3);
  }
}

// Poses controlled the console before our first set-point, as after teleoperation.
TEST_F(LateMessagesTest, AHoldRightAfterArmingHolds) {
  console_.Place(test::PsmHome());
  console_.ServoCp(console_.setpoint_pose());
  for (int i = 0; i < 40; ++i) Step();
  ASSERT_EQ(client_.Arm(), PsmStatus::kOk) << Name(client_.status());
  Step();
  ExpectAForeignHoldIsDetected();
}

// The limit is the window of 0.2 s in which a set-point reaches the console, plus the time to
// leave the tolerance.
TEST_F(LateMessagesTest, ASetpointThatStaysWhileOursMovesOnHolds) {
  Begin();
  deaf_ = true;
  const Eigen::Vector3d there = tip();
  int ms = 0;
  for (; ms < 1000 && client_.phase() == PsmPhase::kArmed; ms += 5) Step();
  EXPECT_EQ(client_.status(), PsmStatus::kSetpointStays) << Name(client_.status());
  EXPECT_LE(ms, 300);
  EXPECT_LT((tip() - there).norm(), 1e-3);
}

}  // namespace
}  // namespace dfr::hardware
