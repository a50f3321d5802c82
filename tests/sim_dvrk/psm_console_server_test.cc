#include "dfr/sim/dvrk/psm_console_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <string>
#include <thread>

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

  bool Home() {
    return Until([&] { return command_.num_subscribers() == 1; }) &&
           command_.Write({.stamp = {}, .frame_id = "", .text = "home"}) && Until([&] {
             state_.TakeNewest(operating_);
             return operating_.is_homed && !operating_.is_busy;
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
  ASSERT_TRUE(Until([&] { return move.num_subscribers() == 1 && goal.health().publishers == 1; }));
  dds::JointState where;
  where.position = {0.1, 0.0, 0.12, 0.0, 0.0, 0.0};
  ASSERT_TRUE(move.Write(where));
  dds::Text text;
  ASSERT_TRUE(Until([&] { return warning_.TakeNewest(text); }));
  EXPECT_EQ(text.text, "PSM1: move_jp dropped, arm not ready: DISABLED");
  ASSERT_TRUE(Home());
  ASSERT_TRUE(move.Write(where));
  dds::Flag reached;
  ASSERT_TRUE(Until([&] { return goal.TakeNewest(reached); }));
  EXPECT_TRUE(reached.value);
  EXPECT_EQ(console_.setpoint_joints()[0], 0.1);
}

TEST_F(PsmConsoleServerTest, FaultsAreSeenByClients) {
  ASSERT_TRUE(Home());
  dds::PoseStamped pose;
  const auto next = [&] { return Until([&] { return pose_.TakeNewest(pose); }); };
  // What was on its way when the fault began may still arrive: so each looks for a second sample.
  server_.SetFaults({.corrupt = true});
  EXPECT_TRUE(Until([&] { return pose_.TakeNewest(pose) && std::isnan(pose.position_m.x()); }));
  server_.SetFaults({.invalid = true});
  EXPECT_TRUE(Until([&] { return pose_.TakeNewest(pose) && !pose.stamp.valid(); }));
  server_.SetFaults({});
  EXPECT_TRUE(Until([&] { return pose_.TakeNewest(pose) && pose.stamp.valid(); }));
  server_.SetFaults({.freeze = true});
  ASSERT_TRUE(next());
  ASSERT_TRUE(next());
  const dds::Stamp frozen = pose.stamp;
  ASSERT_TRUE(next());
  EXPECT_EQ(pose.stamp, frozen);
  server_.SetFaults({.delay_s = 0.5});
  EXPECT_TRUE(Until([&] { return pose_.TakeNewest(pose) && pose.stamp != frozen; }));
  EXPECT_THROW(server_.SetFaults({.drop = 1.5}), std::invalid_argument);
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

}  // namespace
}  // namespace dfr::sim
