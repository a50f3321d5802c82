#include "dfr/sim/dvrk/psm_console_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <stdexcept>
#include <string>
#include <vector>

#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/kinematics/psm_home.h"
#include "tests/support/all_close.h"
#include "tests/support/eventually.h"

namespace dfr::sim {
namespace {

using testing::Each;
using testing::IsEmpty;
using testing::SizeIs;

dds::JointState Joints(const std::vector<double>& position) {
  dds::JointState message;
  message.position = position;
  return message;
}

// A console with its server, and a client's publishers and subscribers, in lock-step.
class PsmConsoleServerTest : public testing::Test {
 protected:
  // Advances by one tick, which publishes one state.
  void Tick() {
    now_ns_ += 10'000'000;
    server_.Tick(0.01);
  }

  // Advances the time until `condition` holds.
  void Until(const std::function<bool()>& condition) {
    test::Eventually([&] {
      if (condition()) return true;
      Tick();
      return false;
    });
  }

  // Repeats the request until the console receives it: discovery is not symmetric.
  void Home() {
    Until([&] {
      if (!console_.busy() && !console_.homed()) command_.Write({{}, "", "home"});
      state_.TakeNewest(operating_);
      return operating_.is_homed && !operating_.is_busy;
    });
  }

  // Sends a motion command until the console has received it, because discovery is not symmetric.
  // On a busy machine the console may receive it more than once, or lose it.
  template <typename T>
  void Command(dds::Publisher<T>& publisher, const T& message) {
    before_ = server_.commands_taken();
    Until([&] {
      publisher.Write(message);
      server_.TakeCommands();
      return times() > 0;
    });
  }
  // Returns the number of times that the console received the last command.
  [[nodiscard]] double times() const {
    return static_cast<double>(server_.commands_taken() - before_);
  }

  std::int64_t now_ns_ = 1'700'000'000'000'000'000;
  std::uint64_t before_ = 0;
  PsmConsole console_{{.arm = "PSM1", .homing_s = 0.2}};
  dds::Participant server_participant_{{.domain = test::OwnDomain()}};
  PsmConsoleServer server_{
      server_participant_, console_, {.state_period_s = 1e-3, .clock = [this] {
                                        return dds::Stamp::FromNanoseconds(now_ns_);
                                      }}};
  dds::Participant client_participant_{{.domain = test::OwnDomain()}};
  dds::Subscriber<dds::OperatingState> state_{client_participant_, "/PSM1/operating_state",
                                              dds::Role::kEvent};
  // Keeps up to a hundred samples.
  dds::Subscriber<dds::PoseStamped> pose_{client_participant_, "/PSM1/measured_cp",
                                          dds::Role::kRequest};
  dds::Subscriber<dds::Text> warning_{client_participant_, "/PSM1/warning", dds::Role::kEvent};
  dds::Publisher<dds::StringStamped> command_{client_participant_, "/PSM1/state_command",
                                              dds::Role::kRequest};
  dds::OperatingState operating_;
};

TEST_F(PsmConsoleServerTest, MeasurementsAreStampedZeroUntilHomedAndMovesReportTheirEnd) {
  dds::Publisher<dds::JointState> move(client_participant_, "/PSM1/move_jp", dds::Role::kRequest);
  dds::Subscriber<dds::Flag> goal(client_participant_, "/PSM1/goal_reached", dds::Role::kState);
  dds::PoseStamped pose;
  Until([&] { return pose_.TakeNewest(pose) && goal.health().publishers == 1; });
  EXPECT_FALSE(pose.stamp.valid());
  const dds::JointState where = Joints({0.1, 0.0, 0.12, 0.0, 0.0, 0.0});
  Command(move, where);
  dds::Text text;
  Until([&] { return warning_.TakeNewest(text); });
  EXPECT_EQ(text.text, "PSM1: move_jp dropped, arm not ready: DISABLED");
  Home();
  EXPECT_EQ(operating_.state, "ENABLED");
  Until([&] { return pose_.TakeNewest(pose) && pose.stamp.valid(); });
  EXPECT_EQ(pose.frame_id, "PSM1_base");
  EXPECT_TRUE(test::AllClose(pose.position_m, Eigen::Vector3d(0.0, 0.0, -0.1135), 1e-12));
  dds::Flag reached;
  Until([&] {
    // Repeats the command until the client learns that the motion is complete.
    if (!console_.busy()) Command(move, where);
    return goal.TakeNewest(reached) && reached.value;
  });
  EXPECT_EQ(console_.setpoint_joints()[0], 0.1);
}

TEST_F(PsmConsoleServerTest, AllCommandsArriveAndAllStatesAgree) {
  const auto commands = [&](const char* topic) {
    return dds::Publisher<dds::JointState>(client_participant_, topic, dds::Role::kCommand);
  };
  auto servo_jr = commands("/PSM1/servo_jr");
  auto servo_jf = commands("/PSM1/servo_jf");
  dds::Publisher<dds::JointState> move_jr(client_participant_, "/PSM1/move_jr",
                                          dds::Role::kRequest);
  dds::Publisher<dds::PoseStamped> servo_cr(client_participant_, "/PSM1/servo_cr",
                                            dds::Role::kCommand);
  dds::Publisher<dds::Signal> free(client_participant_, "/PSM1/free", dds::Role::kRequest);
  dds::Subscriber<dds::TwistStamped> twist(client_participant_, "/PSM1/measured_cv",
                                           dds::Role::kState);
  dds::Subscriber<dds::PoseStamped> local(client_participant_, "/PSM1/local/measured_cp",
                                          dds::Role::kState);
  dds::Subscriber<dds::PoseStamped> local_goal(client_participant_, "/PSM1/local/setpoint_cp",
                                               dds::Role::kState);
  dds::Subscriber<dds::Text> error(client_participant_, "/PSM1/error", dds::Role::kEvent);
  Until([&] { return twist.health().publishers == 1; });
  console_.Place(test::PsmHome());
  const auto yaw = [&] { return console_.setpoint_joints()[0]; };
  const dds::JointState turn = Joints({0.01, 0.0, 0.0, 0.0, 0.0, 0.0});
  // Messages without effect are sent until the console receives the topic. The relevant message is
  // then sent once.
  const dds::JointState nothing = Joints({0.0, 0.0, 0.0, 0.0, 0.0, 0.0});
  Command(servo_jr, nothing);
  servo_jr.Write(turn);
  Until([&] { return std::abs(yaw() - 0.01) < 1e-12; });

  const auto x = [&] { return console_.setpoint_pose().translation().x(); };
  dds::PoseStamped difference;
  Command(servo_cr, difference);
  const double from_x = x();
  difference.position_m.x() = 0.002;
  servo_cr.Write(difference);
  Until([&] { return std::abs(x() - from_x - 0.002) < 1e-9; });

  const double from_yaw = yaw();
  dds::TwistStamped moving;
  Until([&] {
    if (!console_.busy()) move_jr.Write(turn);  // until the motion begins
    return twist.TakeNewest(moving) && moving.linear_m_s.norm() > 1e-3;
  });
  EXPECT_EQ(moving.frame_id, "PSM1_base");
  Until([&] { return yaw() > from_yaw && !console_.busy(); });

  Command(servo_jf, turn);
  dds::Text text;
  Until([&] { return error.TakeNewest(text); });
  EXPECT_THAT(text.text, testing::HasSubstr("servo_jf dropped"));

  dds::PoseStamped pose;
  dds::PoseStamped same;
  Until([&] {
    pose_.TakeNewest(pose);
    local.TakeNewest(same);
    return pose.stamp.valid() && pose.stamp == same.stamp;
  });
  EXPECT_EQ(pose.position_m, same.position_m);
  Until([&] { return local_goal.TakeNewest(same); });

  const double start = yaw();
  Until([&] {
    if (!console_.busy()) move_jr.Write(Joints({0.5, 0.0, 0.0, 0.0, 0.0, 0.0}));
    return yaw() > start + 0.02;
  });
  test::Eventually([&] {  // until the motion ends
    free.Write({});
    server_.TakeCommands();
    return !console_.busy();
  });
  EXPECT_LT(yaw(), start + 0.45);
}

// servo_cs is servo_cp with a twist, which the simulated joints ignore.
TEST_F(PsmConsoleServerTest, CartesianStatesAreGoals) {
  dds::Publisher<dds::CartesianState> servo(client_participant_, "/PSM1/servo_cs",
                                            dds::Role::kCommand);
  console_.Place(test::PsmHome());
  dds::CartesianState goal;
  const Eigen::Isometry3d home = console_.setpoint_pose();
  goal.position_m = home.translation() + Eigen::Vector3d(0.002, 0.0, 0.0);
  goal.orientation = Eigen::Quaterniond(home.linear());
  Command(servo, goal);
  EXPECT_TRUE(console_.setpoint_pose().isApprox(home)) << "its pose is not valid";
  goal.pose_valid = true;
  goal.orientation.coeffs() *= 3.0;
  Command(servo, goal);
  EXPECT_TRUE(console_.setpoint_pose().isApprox(home)) << "that is not an orientation";
  goal.orientation.normalize();
  Until([&] {
    servo.Write(goal);
    return std::abs(console_.setpoint_pose().translation().x() - home.translation().x() - 0.002) <
           1e-9;
  });
}

// Tests each fault by its name and its effect on a client.
class ConsoleFaultTest : public PsmConsoleServerTest {
 protected:
  void SetUp() override {
    console_.Place(test::PsmHome());
    Until([&] {
      dds::PoseStamped pose;
      return pose_.Take(pose);
    });
    (void)Collect();
  }

  // Publishes a pose. Returns it with all earlier poses that no call has taken.
  std::vector<dds::PoseStamped> Collect() {
    Tick();
    std::vector<dds::PoseStamped> poses;
    test::Eventually([&] {
      dds::PoseStamped pose;
      while (pose_.Take(pose)) {
        if (pose.stamp == server_.now()) return true;
        poses.push_back(pose);
      }
      return false;
    });
    return poses;
  }

  // Returns the poses received in `ticks` ticks with one fault, which then ends.
  std::vector<dds::PoseStamped> With(const std::string& name, const std::string& value, int ticks) {
    ConsoleFaults faults;
    EXPECT_TRUE(SetFault(faults, name, value));
    server_.SetFaults(faults);
    start_ns_ = now_ns_;
    for (int i = 0; i < ticks; ++i) Tick();
    end_ns_ = now_ns_;
    server_.SetFaults({});
    return Collect();
  }

  std::int64_t start_ns_ = 0;
  std::int64_t end_ns_ = 0;
};

MATCHER(IsNan, "") { return arg.position_m.array().isNaN().all(); }
MATCHER(HasNoStamp, "") { return !arg.stamp.valid(); }
MATCHER_P(IsStamped, ns, "") { return arg.stamp.nanoseconds() == ns; }

TEST_F(ConsoleFaultTest, StatesAreCorruptedOrLost) {
  EXPECT_THAT(With("corrupt", "1", 3), testing::AllOf(SizeIs(3), Each(IsNan())));
  EXPECT_THAT(With("invalid", "1", 3), testing::AllOf(SizeIs(3), Each(HasNoStamp())));
  const std::int64_t last = now_ns_;
  EXPECT_THAT(With("freeze", "1", 3), testing::AllOf(SizeIs(3), Each(IsStamped(last))));
  const std::vector<dds::PoseStamped> ahead = With("clock_jump", "3600", 1);
  EXPECT_THAT(ahead, testing::ElementsAre(IsStamped(end_ns_ + 3'600'000'000'000)));
  EXPECT_THAT(With("silent", "1", 20), IsEmpty());
  EXPECT_THAT(With("drop", "1", 20), IsEmpty());
  // The mean is 30, the standard deviation 3.9. The limits are four standard deviations away.
  EXPECT_THAT(With("drop", "0.5", 60), SizeIs(testing::AllOf(testing::Gt(14U), testing::Lt(46U))));
  server_.SetFaults({.silent = true});
  console_.StateCommand("pause");
  Until([&] { return state_.TakeNewest(operating_) && operating_.state == "PAUSED"; });
}

TEST_F(ConsoleFaultTest, StatesAreLate) {
  const std::vector<dds::PoseStamped> old = With("delay", "0.4", 60);
  ASSERT_FALSE(old.empty());
  EXPECT_NEAR(1e-9 * static_cast<double>(end_ns_ - old.back().stamp.nanoseconds()), 0.4, 0.011);

  server_.SetFaults({.jitter_s = 0.2});
  int longest = 0;  // number of consecutive ticks without a message
  int gap = 0;
  for (int i = 0; i < 100; ++i) {
    const std::uint64_t before = server_.states_published();
    Tick();
    gap = server_.states_published() > before ? 0 : gap + 1;
    longest = std::max(longest, gap);
  }
  EXPECT_GT(longest, 2);
  server_.SetFaults({});
  const std::vector<dds::PoseStamped> uneven = Collect();
  EXPECT_TRUE(std::is_sorted(uneven.begin(), uneven.end(), [](const auto& a, const auto& b) {
    return a.stamp.nanoseconds() < b.stamp.nanoseconds();
  }));
}

TEST_F(ConsoleFaultTest, CommandsAreLost) {
  dds::Publisher<dds::JointState> servo(client_participant_, "/PSM1/servo_jp", dds::Role::kCommand);
  const dds::JointState joints = Joints({0.01, 0.0, 0.12, 0.0, 0.0, 0.0});
  server_.SetFaults({.drop_commands = 1.0});
  Command(servo, joints);
  Tick();
  EXPECT_EQ(console_.setpoint_joints()[0], 0.0);
  server_.SetFaults({});
  Until([&] {
    servo.Write(joints);
    return console_.setpoint_joints()[0] == 0.01;
  });
}

TEST_F(ConsoleFaultTest, ValuesOutOfRangeAreRefusedByName) {
  ConsoleFaults faults;
  EXPECT_FALSE(SetFault(faults, "dust", "1"));
  EXPECT_THROW((void)SetFault(faults, "freeze", "yes"), std::invalid_argument);
  for (const char* value : {"", "1s"}) {
    EXPECT_THROW((void)SetFault(faults, "delay", value), std::invalid_argument);
  }
  for (const ConsoleFaults& refused :
       {ConsoleFaults{.delay_s = 3.0}, ConsoleFaults{.jitter_s = -1.0}, ConsoleFaults{.drop = 1.5},
        ConsoleFaults{.drop_commands = std::nan("")}, ConsoleFaults{.clock_jump_s = 1e9}}) {
    EXPECT_THROW(server_.SetFaults(refused), std::invalid_argument);
  }
}

}  // namespace
}  // namespace dfr::sim
