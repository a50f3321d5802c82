#include "dfr/sim/dvrk/psm_console_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <functional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "dfr/dds/channel.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/support/all_close.h"

namespace dfr::sim {
namespace {

using Clock = std::chrono::steady_clock;

// A served arm and a client's ends of its topics. Time only goes on in Until(): lock-step.
class PsmConsoleServerTest : public testing::Test {
 protected:
  // Lets 2 ms of the console's time pass at each millisecond or so, until `condition`.
  bool Until(const std::function<bool()>& condition) {
    const auto end = Clock::now() + std::chrono::seconds(60);
    while (!condition()) {
      if (Clock::now() > end) return false;
      server_.Tick(2e-3);
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return true;
  }

  // Asks again and again, as clients do: that this side has found the console does not mean that
  // the console has found this side.
  bool Home() {
    int asked = 0;
    return Until([&] {
      if (asked++ % 50 == 0) command_.Write({.stamp = {}, .frame_id = "", .text = "home"});
      state_.TakeNewest(operating_);
      return operating_.is_homed && !operating_.is_busy;
    });
  }

  // Sends a motion command until the console has taken it, for the same reason.
  template <typename T>
  bool Command(dds::Publisher<T>& publisher, const T& message) {
    const std::uint64_t before = server_.commands_taken();
    int sent = 0;
    return Until([&] {
      if (sent++ % 200 == 0) publisher.Write(message);
      return server_.commands_taken() > before;
    });
  }

  PsmConsole console_{{.arm = "PSM1", .homing_s = 0.2}};
  dds::Participant server_participant_{{.domain = test::OwnDomain()}};
  PsmConsoleServer server_{server_participant_, console_};
  dds::Participant client_participant_{{.domain = test::OwnDomain()}};
  dds::Subscriber<dds::OperatingState> state_{client_participant_, "/PSM1/operating_state",
                                              dds::Role::kEvent};
  dds::Subscriber<dds::PoseStamped> pose_{client_participant_, "/PSM1/measured_cp",
                                          dds::Role::kState};
  dds::Subscriber<dds::Text> warning_{client_participant_, "/PSM1/warning", dds::Role::kEvent};
  dds::Publisher<dds::StringStamped> command_{client_participant_, "/PSM1/state_command",
                                              dds::Role::kRequest};
  dds::OperatingState operating_;
};

TEST_F(PsmConsoleServerTest, MeasurementsAreStampedZeroUntilHomed) {
  dds::PoseStamped pose;
  ASSERT_TRUE(Until([&] { return pose_.TakeNewest(pose); }));
  EXPECT_FALSE(pose.stamp.valid());
  ASSERT_TRUE(Home());
  EXPECT_EQ(operating_.state, "ENABLED");
  ASSERT_TRUE(Until([&] { return pose_.TakeNewest(pose) && pose.stamp.valid(); }));
  EXPECT_EQ(pose.frame_id, "PSM1_base");
  EXPECT_TRUE(test::AllClose(pose.position_m, Eigen::Vector3d(0.0, 0.0, -0.1135), 1e-12));
}

TEST_F(PsmConsoleServerTest, MovesTellWhenTheyAreDone) {
  dds::Publisher<dds::JointState> move(client_participant_, "/PSM1/move_jp", dds::Role::kRequest);
  dds::Subscriber<dds::Flag> goal(client_participant_, "/PSM1/goal_reached", dds::Role::kState);
  ASSERT_TRUE(Until([&] { return goal.health().publishers == 1; }));
  dds::JointState where;
  where.position = {0.1, 0.0, 0.12, 0.0, 0.0, 0.0};
  ASSERT_TRUE(Command(move, where));
  dds::Text text;
  ASSERT_TRUE(Until([&] { return warning_.TakeNewest(text); }));
  EXPECT_EQ(text.text, "PSM1: move_jp dropped, arm not ready: DISABLED");
  ASSERT_TRUE(Home());
  ASSERT_TRUE(Command(move, where));
  dds::Flag reached;
  ASSERT_TRUE(Until([&] { return goal.TakeNewest(reached); }));
  EXPECT_TRUE(reached.value);
  EXPECT_EQ(console_.setpoint_joints()[0], 0.1);
}

TEST_F(PsmConsoleServerTest, AllCommandsArriveAndAllStatesAgree) {
  dds::Publisher<dds::JointState> servo_jr(client_participant_, "/PSM1/servo_jr",
                                           dds::Role::kCommand);
  dds::Publisher<dds::JointState> servo_jf(client_participant_, "/PSM1/servo_jf",
                                           dds::Role::kCommand);
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
  ASSERT_TRUE(Until([&] { return twist.health().publishers == 1; }));
  ASSERT_TRUE(Home());
  dds::JointState joints;
  joints.position = {0.01, 0.0, 0.0, 0.0, 0.0, 0.0};
  ASSERT_TRUE(Command(servo_jr, joints));
  ASSERT_TRUE(Until([&] { return console_.setpoint_joints()[0] == 0.01; }));
  dds::PoseStamped difference;
  difference.position_m.x() = 0.002;
  const double x = console_.setpoint_pose().translation().x();
  ASSERT_TRUE(Command(servo_cr, difference));
  ASSERT_TRUE(Until(
      [&] { return std::abs(console_.setpoint_pose().translation().x() - x - 0.002) < 1e-12; }));
  const double yaw = console_.setpoint_joints()[0];
  ASSERT_TRUE(Command(move_jr, joints));
  dds::TwistStamped moving;
  ASSERT_TRUE(Until([&] { return twist.TakeNewest(moving) && moving.linear_m_s.norm() > 1e-3; }));
  EXPECT_EQ(moving.frame_id, "PSM1_base");
  ASSERT_TRUE(Until([&] { return std::abs(console_.setpoint_joints()[0] - yaw - 0.01) < 1e-12; }));
  ASSERT_TRUE(Command(servo_jf, joints));
  dds::Text text;
  ASSERT_TRUE(Until([&] { return error.TakeNewest(text); }));
  EXPECT_THAT(text.text, testing::HasSubstr("servo_jf dropped"));
  dds::PoseStamped pose;
  dds::PoseStamped same;
  ASSERT_TRUE(Until([&] {
    pose_.TakeNewest(pose);
    local.TakeNewest(same);
    return pose.stamp.valid() && pose.stamp == same.stamp;
  }));
  EXPECT_EQ(pose.position_m, same.position_m);
  ASSERT_TRUE(Until([&] { return local_goal.TakeNewest(same); }));
  joints.position[0] = 0.5;
  ASSERT_TRUE(Command(move_jr, joints));
  ASSERT_TRUE(console_.busy());
  const double goal = console_.setpoint_joints()[0];
  ASSERT_TRUE(Until([&] {
    free.Write({});
    return !console_.busy();
  }));
  EXPECT_LT(console_.setpoint_joints()[0], goal + 0.45);
}

// Each fault by its name, seen from a client's side, and gone when it is switched off.
class ConsoleFaultTest : public PsmConsoleServerTest {
 protected:
  void SetUp() override { ASSERT_TRUE(Home()); }

  void Set(const std::string& name, const std::string& value) {
    ConsoleFaults faults = server_.faults();
    ASSERT_TRUE(SetFault(faults, name, value));
    server_.SetFaults(faults);
    // What was on its way when the fault began may still arrive.
    for (int i = 0; i < 20; ++i) Tick();
    pose_.TakeNewest(pose);
  }
  void Tick() {
    server_.Tick(2e-3);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  // Poses that come in so many of the console's milliseconds.
  int Count(int ms) {
    int count = 0;
    for (int i = 0; i < ms / 2; ++i) {
      Tick();
      count += pose_.TakeNewest(pose) ? 1 : 0;
    }
    return count;
  }
  bool Fresh() {
    return Until([&] {
      return pose_.TakeNewest(pose) && pose.stamp.valid() && std::isfinite(pose.position_m.x()) &&
             std::abs(Age()) < 0.1;
    });
  }
  [[nodiscard]] double Age() const {
    return 1e-9 * static_cast<double>(dds::Stamp::Now().nanoseconds() - pose.stamp.nanoseconds());
  }

  dds::PoseStamped pose;
};

TEST_F(ConsoleFaultTest, CorruptPositionsAreNaN) {
  Set("corrupt", "1");
  ASSERT_TRUE(Until([&] { return pose_.TakeNewest(pose); }));
  EXPECT_TRUE(pose.position_m.array().isNaN().all());
  Set("corrupt", "0");
  EXPECT_TRUE(Fresh());
}

TEST_F(ConsoleFaultTest, InvalidIsStampedZero) {
  Set("invalid", "1");
  ASSERT_TRUE(Until([&] { return pose_.TakeNewest(pose); }));
  EXPECT_FALSE(pose.stamp.valid());
  Set("invalid", "0");
  EXPECT_TRUE(Fresh());
}

TEST_F(ConsoleFaultTest, FrozenRepeatsTheSameState) {
  Set("freeze", "1");
  ASSERT_TRUE(Until([&] { return pose_.TakeNewest(pose); }));
  const dds::Stamp frozen = pose.stamp;
  EXPECT_GT(Count(200), 10);
  EXPECT_EQ(pose.stamp, frozen);
  Set("freeze", "0");
  EXPECT_TRUE(Fresh());
}

TEST_F(ConsoleFaultTest, SilentSaysNothingAboutMotion) {
  Set("silent", "1");
  EXPECT_EQ(Count(200), 0);
  ASSERT_TRUE(command_.Write({.stamp = {}, .frame_id = "", .text = "pause"}));
  EXPECT_TRUE(Until([&] { return state_.TakeNewest(operating_) && operating_.state == "PAUSED"; }));
  Set("silent", "0");
  EXPECT_TRUE(Fresh());
}

// 100 Hz of the console's time: 200 states, of which half come, give or take 7 (one standard
// deviation); the limits are four of them away.
TEST_F(ConsoleFaultTest, DroppedStatesAreLost) {
  const int all = Count(2000);
  EXPECT_GT(all, 150);  // two that come in one millisecond count once
  Set("drop", "0.5");
  const int half = Count(2000);
  EXPECT_LT(half, 130);
  EXPECT_GT(half, 70);
  Set("drop", "1");
  EXPECT_EQ(Count(200), 0);
  Set("drop", "0");
  EXPECT_TRUE(Fresh());
}

TEST_F(ConsoleFaultTest, DroppedCommandsAreLost) {
  dds::Publisher<dds::JointState> servo(client_participant_, "/PSM1/servo_jp", dds::Role::kCommand);
  Set("drop_commands", "1");
  dds::JointState joints;
  joints.position = {0.01, 0.0, 0.12, 0.0, 0.0, 0.0};
  ASSERT_TRUE(Command(servo, joints));
  EXPECT_EQ(console_.setpoint_joints()[0], 0.0);
  Set("drop_commands", "0");
  ASSERT_TRUE(Command(servo, joints));
  EXPECT_TRUE(Until([&] { return console_.setpoint_joints()[0] == 0.01; }));
}

TEST_F(ConsoleFaultTest, DelayedStatesAreOldOnArrival) {
  // Time of the console: at least half as much by the wall's clock, which sleeps a millisecond.
  Set("delay", "0.4");
  ASSERT_TRUE(Until([&] { return pose_.TakeNewest(pose); }));
  EXPECT_GT(Age(), 0.2);
  Set("delay", "0");
  EXPECT_TRUE(Fresh());
}

TEST_F(ConsoleFaultTest, JitterMakesIntervalsUneven) {
  Set("jitter", "0.2");
  std::vector<int> gaps;  // in ticks of 2 ms
  int gap = 0;
  for (int i = 0; i < 1000; ++i) {
    Tick();
    ++gap;
    if (!pose_.TakeNewest(pose)) continue;
    gaps.push_back(gap);
    gap = 0;
  }
  ASSERT_GT(gaps.size(), 10U);
  EXPECT_GT(*std::max_element(gaps.begin(), gaps.end()), 10);  // two periods
  Set("jitter", "0");
  EXPECT_TRUE(Fresh());
}

TEST_F(ConsoleFaultTest, ClockJumpsMoveAllStamps) {
  Set("clock_jump", "3600");
  ASSERT_TRUE(Until([&] { return pose_.TakeNewest(pose); }));
  EXPECT_NEAR(Age(), -3600.0, 60.0);  // a busy machine's patience
  Set("clock_jump", "-3600");
  ASSERT_TRUE(Until([&] { return pose_.TakeNewest(pose); }));
  EXPECT_NEAR(Age(), 3600.0, 60.0);
  Set("clock_jump", "0");
  EXPECT_TRUE(Fresh());
}

TEST_F(ConsoleFaultTest, ValuesOutOfRangeAreRefusedByName) {
  ConsoleFaults faults;
  EXPECT_FALSE(SetFault(faults, "dust", "1"));
  EXPECT_THROW((void)SetFault(faults, "freeze", "yes"), std::invalid_argument);
  EXPECT_THROW((void)SetFault(faults, "delay", ""), std::invalid_argument);
  EXPECT_THROW((void)SetFault(faults, "delay", "1s"), std::invalid_argument);
  EXPECT_THROW(server_.SetFaults({.delay_s = 3.0}), std::invalid_argument);
  EXPECT_THROW(server_.SetFaults({.jitter_s = -1.0}), std::invalid_argument);
  EXPECT_THROW(server_.SetFaults({.drop = 1.5}), std::invalid_argument);
  EXPECT_THROW(server_.SetFaults({.drop_commands = std::nan("")}), std::invalid_argument);
  EXPECT_THROW(server_.SetFaults({.clock_jump_s = 1e9}), std::invalid_argument);
}

// An independent implementation homes and moves the arm.
TEST_F(PsmConsoleServerTest, CycloneClientHomesAndMovesTheArm) {
  test::PeerProcess client({DFR_CYCLONE_CLIENT, std::to_string(test::OwnDomain())});
  int code = -1;
  ASSERT_TRUE(Until([&] {
    code = client.Await(1e-3);
    return code >= 0;
  }));
  EXPECT_EQ(code, 0);
}

// The calls of dvrk_python's test scripts, one after another.
TEST_F(PsmConsoleServerTest, AnswersWhateverTheScriptsOfDvrkPythonAsk) {
  test::PeerProcess client({DFR_CYCLONE_SCRIPT, std::to_string(test::OwnDomain())});
  int code = -1;
  const auto end = Clock::now() + std::chrono::seconds(240);
  while (code < 0 && Clock::now() < end) {
    server_.Tick(2e-3);
    code = client.Await(1e-3);
  }
  EXPECT_EQ(code, 0);
}

// servo_cs is servo_cp with a twist, which the simulated joints have no use for.
TEST_F(PsmConsoleServerTest, CartesianStatesAreGoals) {
  dds::Publisher<dds::CartesianState> servo(client_participant_, "/PSM1/servo_cs",
                                            dds::Role::kCommand);
  ASSERT_TRUE(Home());
  dds::CartesianState goal;
  const Eigen::Isometry3d home = console_.setpoint_pose();
  goal.position_m = home.translation() + Eigen::Vector3d(0.002, 0.0, 0.0);
  goal.orientation = Eigen::Quaterniond(home.linear());
  ASSERT_TRUE(Command(servo, goal));
  EXPECT_TRUE(console_.setpoint_pose().isApprox(home)) << "its pose is not valid";
  goal.pose_valid = true;
  goal.orientation.coeffs() *= 3.0;
  ASSERT_TRUE(Command(servo, goal));
  EXPECT_TRUE(console_.setpoint_pose().isApprox(home)) << "that is no orientation";
  goal.orientation.normalize();
  ASSERT_TRUE(Command(servo, goal));
  EXPECT_TRUE(Until([&] {
    return std::abs(console_.setpoint_pose().translation().x() - home.translation().x() - 0.002) <
           1e-9;
  }));
}

}  // namespace
}  // namespace dfr::sim
