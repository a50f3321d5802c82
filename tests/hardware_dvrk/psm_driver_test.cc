#include "dfr/hardware/psm_driver.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "dfr/dds/channel.h"
#include "dfr/sim/dvrk/psm_console_server.h"
#include "tests/dds/domain.h"
#include "tests/hardware_dvrk/psm_driver_fixture.h"
#include "tests/support/all_close.h"
#include "tests/support/eventually.h"

namespace dfr::hardware {
namespace {

using kinematics::PsmJoints;
using testing::HasSubstr;

TEST_F(PsmDriverTest, HomesMovesAndComesToRest) {
  const auto driver = Connected();
  std::vector<std::string> said;
  ASSERT_EQ(BringUp(
                *driver, 60.0, [&](std::string_view text) { said.emplace_back(text); }, {},
                InStep(*driver)),
            PsmStatus::kOk)
      << driver->Explain();
  EXPECT_THAT(said, testing::Contains(HasSubstr("homed")));
  PsmJoints goal;
  goal << 0.05, -0.03, 0.125, 0.1, 0.05, -0.05;
  ASSERT_EQ(driver->MoveTo(goal, 0.5), PsmStatus::kOk);
  ASSERT_EQ(driver->MoveJaw(0.3, 0.5), PsmStatus::kOk);
  Until(*driver, [&] { return driver->at_rest() || driver->phase() != PsmPhase::kArmed; });
  ASSERT_EQ(driver->status(), PsmStatus::kOk) << driver->Explain();
  EXPECT_TRUE(test::AllClose(driver->client().measured_js().position, goal, 0.02));
  Until(*driver, [&] {
    return test::AllClose(console_.setpoint_joints(), goal, 1e-9) &&
           std::abs(console_.setpoint_jaw() - 0.3) < 1e-12;
  });
  EXPECT_EQ(driver->other_publishers(), 0);
}

TEST_F(PsmDriverTest, SendsNoRequestIfMotionIsForbidden) {
  const auto driver = Connected();
  EXPECT_EQ(BringUp(
                *driver, 60.0, {}, [] { return false; }, InStep(*driver)),
            PsmStatus::kHeld);
  Step(*driver);
  EXPECT_EQ(console_.state(), sim::ArmState::kDisabled);
}

TEST_F(PsmDriverTest, HomingEndsWithTheArmDisabledWhenItMayNoLongerMoveOrTimesOut) {
  console_ = sim::PsmConsole({.arm = "PSM1", .homing_s = 30.0});
  const auto disabled = [&] {
    server_.TakeCommands();
    return console_.state() == sim::ArmState::kDisabled;
  };
  {
    const auto driver = Connected();
    EXPECT_EQ(BringUp(
                  *driver, 60.0, {}, [&] { return !console_.busy(); }, InStep(*driver)),
              PsmStatus::kHeld);
    test::Eventually(disabled);
  }
  {
    const auto driver = Connected();
    ASSERT_EQ(driver->Home(), PsmStatus::kOk);
    Until(*driver, [&] { return console_.busy(); });
  }
  test::Eventually(disabled);  // a driver that ends disables an arm that is homing
  const auto driver = Connected();
  EXPECT_EQ(BringUp(*driver, 2.0, {}, {}, InStep(*driver)), PsmStatus::kTimedOut);
  EXPECT_EQ(driver->phase(), PsmPhase::kHolding);
  test::Eventually(disabled);
}

// The next publisher publishes changes only.
TEST_F(PsmDriverTest, TeleoperationAndClutchEndWithTheirPublisher) {
  const auto driver = Connected();
  console_.Place(test::PsmHome());
  const auto ends = [&](PsmStatus cause, const char* topic, const auto& message) {
    {
      dds::Participant other({.domain = test::OwnDomain()});
      dds::Publisher<std::decay_t<decltype(message)>> said(other, topic, dds::Role::kEvent);
      ASSERT_TRUE(said.Write(message));
      Until(*driver, [&] { return driver->client().hold_reason() == cause; });
    }
    Until(*driver, [&] { return driver->client().hold_reason() == PsmStatus::kOk; });
  };
  ends(PsmStatus::kTeleoperated, "/console/teleop/enabled", dds::Flag{.value = true});
  ends(PsmStatus::kClutched, "/PSM1/arm_clutch", dds::Joy{{}, {}, {}, {1}});
}

TEST_F(PsmDriverTest, AFaultIsQuotedAndNeedsDisableHomeAndArmAndAPauseResumeAndArm) {
  const auto driver = Armed();
  ASSERT_EQ(driver->MoveTo(Yaw(0.2), 3.0), PsmStatus::kOk);
  Until(*driver, [&] { return driver->client().setpoint()[0] > 0.01; });
  console_.Fail("encoder 3 is off");
  Until(*driver, [&] {
    return driver->client().hold_reason() == PsmStatus::kConsoleFault &&
           !driver->last_error().empty();
  });
  EXPECT_EQ(driver->phase(), PsmPhase::kHolding);
  EXPECT_THAT(driver->status(), testing::AnyOf(PsmStatus::kConsoleFault, PsmStatus::kConsoleError));
  EXPECT_THAT(driver->Explain(), HasSubstr("\"PSM1: encoder 3 is off\""));
  EXPECT_EQ(BringUp(*driver, 60.0, {}, {}, InStep(*driver)), PsmStatus::kConsoleFault);
  ASSERT_EQ(driver->Request(PsmRequest::kDisable), PsmStatus::kOk);
  Until(*driver, [&] { return driver->status() == PsmStatus::kDisabled; });
  EXPECT_EQ(BringUp(*driver, 60.0, {}, {}, InStep(*driver)), PsmStatus::kOk) << driver->Explain();
  console_.StateCommand("pause");
  ExpectHolds(*driver, PsmStatus::kPaused);
  console_.StateCommand("resume");
  Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
}

TEST_F(PsmDriverTest, EveryTopicThatCommandsTheArmIsWatched) {
  dds::Participant intruder({.domain = test::OwnDomain()});
  Meet(intruder);
  const auto driver = Armed();
  // Publishers of other topics cause no hold: a topic of another arm, and a topic without commands.
  const dds::Publisher<dds::Text> elsewhere(intruder, "/PSM11/servo_cs", dds::Role::kRequest);
  const dds::Publisher<dds::Text> nearby(intruder, "/PSM1/servo", dds::Role::kRequest);
  const auto holds = [&] {
    ExpectHolds(*driver, PsmStatus::kOtherPublisher);
    EXPECT_EQ(driver->Arm(), PsmStatus::kOtherPublisher);
    EXPECT_EQ(driver->other_publishers(), 1);
    EXPECT_THAT(driver->who(), HasSubstr("'dfr' at 127.0.0.1 publishes /PSM1/"));
    EXPECT_THAT(driver->Explain(), HasSubstr(driver->who()));
  };
  {
    const dds::Publisher<dds::PoseStamped> second(intruder, "/PSM1/servo_cp", dds::Role::kCommand);
    holds();
  }
  // A publisher also causes a hold if its type is unknown to the driver. The test uses an arbitrary
  // type.
  for (const char* topic :
       {"servo_ci", "body/servo_cf", "move_jp", "interpolate_cp", "jaw/servo_jp", "jaw/move_jp"}) {
    SCOPED_TRACE(topic);
    Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
    const dds::Publisher<dds::Text> second(intruder, std::string("/PSM1/") + topic,
                                           dds::Role::kRequest);
    holds();
  }
  Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
  const dds::Publisher<dds::JointState> state(intruder, "/PSM1/measured_js", dds::Role::kState);
  ExpectHolds(*driver, PsmStatus::kSecondConsole);
}

// The loop's time is stopped: the next tick acts on each received message.
TEST_F(PsmDriverTest, MessagesOfOthersHold) {
  dds::Participant other({.domain = test::OwnDomain(), .name = "other"});
  Meet(other);
  const auto driver = Armed();
  const auto holds = [&](PsmStatus cause, const std::function<void()>& say,
                         const std::function<void()>& unsay = {}) {
    SCOPED_TRACE(Name(cause));
    Until(*driver, [&] {
      if (driver->Arm() != PsmStatus::kOk) return false;
      Step(*driver);
      return driver->MoveTo(Yaw(driver->client().setpoint()[0] + 0.1), 5.0) == PsmStatus::kOk;
    });
    for (int i = 0; i < 3; ++i) Step(*driver);
    test::Eventually([&] {
      say();  // until the driver has received it
      Tick(*driver);
      return driver->phase() != PsmPhase::kArmed;
    });
    EXPECT_EQ(driver->status(), cause) << driver->Explain();
    const double last = driver->client().setpoint()[0];
    for (int i = 0; i < 20; ++i) Step(*driver);
    EXPECT_LE(console_.setpoint_joints()[0], last + 1e-9) << "the arm moves on";
    if (unsay) unsay();
  };
  dds::Publisher<dds::Flag> following(other, "/MTMR_PSM1/following", dds::Role::kEvent);
  holds(
      PsmStatus::kTeleoperated, [&] { following.Write({true}); },
      [&] { following.Write({false}); });
  // This publisher keeps nothing for late joiners.
  dds::Publisher<dds::Flag> enabled(other, "/console/teleop/enabled", dds::Role::kRequest);
  holds(
      PsmStatus::kTeleoperated, [&] { enabled.Write({true}); }, [&] { enabled.Write({false}); });
  for (const char* topic : {"/PSM1/arm_clutch", "/PSM1/manip_clutch"}) {
    dds::Publisher<dds::Joy> button(other, topic, dds::Role::kEvent);
    const auto press = [&](int down) { button.Write({{}, "", {}, {down}}); };
    holds(
        PsmStatus::kClutched, [&] { press(1); }, [&] { press(0); });
    Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
  }
  dds::Publisher<dds::Text> tool(other, "/PSM1/tool_type", dds::Role::kEvent);
  // Names the console's own instrument first, then other instruments.
  tool.Write({"LARGE_NEEDLE_DRIVER:400006"});
  holds(PsmStatus::kToolChanged, [&] { tool.Write({"LARGE_NEEDLE_DRIVER_SI:420006"}); });
  holds(
      PsmStatus::kWrongTool, [&] { tool.Write({"PROGRASP_FORCEPS:400093"}); },
      [&] { tool.Write({"LARGE_NEEDLE_DRIVER:400006"}); });
  dds::Publisher<dds::Signal> hold(other, "/PSM1/hold", dds::Role::kRequest);
  dds::Publisher<dds::Signal> free(other, "/PSM1/free", dds::Role::kRequest);
  dds::Publisher<dds::StringStamped> state(other, "/PSM1/state_command", dds::Role::kRequest);
  // Earlier participants are admitted. A participant found later is a reason to hold, even without
  // a message.
  test::Eventually([&] { return driver->Requesters().size() == 3; });
  holds(PsmStatus::kForeignMessage, [&] { hold.Write({}); });
  EXPECT_THAT(driver->who(), HasSubstr("'other' at 127.0.0.1 publishes /PSM1/hold"));
  holds(PsmStatus::kForeignMessage, [&] { free.Write({}); });
  holds(PsmStatus::kForeignMessage, [&] { state.Write({{}, "", "enable"}); });
}

TEST_F(PsmDriverTest, AFloodOfTextsIsSuppressedButAnErrorInItHolds) {
  dds::Participant other({.domain = test::OwnDomain()});
  dds::Publisher<dds::Text> status(other, "/PSM1/status", dds::Role::kEvent);
  dds::Publisher<dds::Text> error(other, "/PSM1/error", dds::Role::kEvent);
  Meet(other);
  const auto driver = Armed();
  std::vector<std::string> shown;
  const auto take = [&] {
    for (ConsoleMessage message; driver->TakeMessage(message);) shown.emplace_back(message.view());
  };
  for (int i = 0; i < 150; ++i) Step(*driver);  // the console has stopped sending
  take();
  shown.clear();
  for (int i = 0; i < 50; ++i) {
    // Waits until the driver has received the message, without advancing its loop's time.
    status.Write({"\x1b[2Jnothing " + std::to_string(i)});
    Tick(*driver);
  }
  test::Eventually([&] {
    error.Write({"the last straw"});
    Tick(*driver);
    take();
    return driver->phase() == PsmPhase::kHolding && std::ranges::count(shown, "?[2Jnothing 4") > 0;
  });
  EXPECT_EQ(driver->status(), PsmStatus::kConsoleError);
  EXPECT_THAT(shown, testing::Contains("the last straw"));
  EXPECT_LE(shown.size(), 10U);
  shown.clear();
  // Errors written above may still arrive.
  Until(*driver, [&] {
    take();
    return std::ranges::any_of(
        shown, [](const std::string& text) { return text.ends_with("messages were suppressed"); });
  });
  EXPECT_LE(shown.size(), 10U);
}

// The driver also reads suppressed messages.
TEST_F(PsmDriverTest, AStatementInAFloodOfTextsHoldsAndIsTheReason) {
  dds::Participant other({.domain = test::OwnDomain()});
  dds::Publisher<dds::Text> status(other, "/PSM1/status", dds::Role::kEvent);
  Meet(other);
  const auto driver = Armed();
  // Waits until the console no longer states its previous control.
  for (int i = 0; i < 20; ++i) Step(*driver);
  EXPECT_EQ(driver->MoveTo(Yaw(0.3), 4.0), PsmStatus::kOk);
  for (int i = 0; i < 100; ++i) Step(*driver);
  for (int i = 0; i < 50; ++i) {
    status.Write({"nothing"});
    Tick(*driver);
  }
  ASSERT_TRUE(driver->moving()) << driver->Explain();
  const Eigen::Vector3d there = console_.measured_pose().translation();
  console_.Hold();
  ExpectHolds(*driver, PsmStatus::kForeignControl);
  EXPECT_TRUE(driver->held_by_others());
  EXPECT_EQ(driver->who(), "PSM1: control JOINT_SPACE/POSITION_MODE");
  EXPECT_THAT(driver->Explain(), HasSubstr("obeyed a hold, free or other command"));
  EXPECT_THAT(driver->Explain(), HasSubstr(driver->who()));
  for (int n = 0; n < 50; ++n) Step(*driver);
  EXPECT_LT((console_.measured_pose().translation() - there).norm(), 1e-3);
}

// The console may have received messages that never arrive at the driver.
TEST_F(PsmDriverTest, ANewParticipantHoldsBeforeItsFirstMessage) {
  const auto driver = Armed();
  Until(*driver, [&] { return driver->MoveTo(Yaw(0.1), 5.0) == PsmStatus::kOk; });
  dds::Participant guest({.domain = test::OwnDomain(), .name = "gu\x1b[2Jest"});
  ExpectHolds(*driver, PsmStatus::kNewcomer);
  EXPECT_EQ(driver->who(), "'gu?[2Jest' at 127.0.0.1");
  EXPECT_TRUE(driver->Requesters().empty());
  // The participant's publications on other topics and its departure have no effect.
  Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
  {
    const std::uint64_t before = participant_.num_found();
    const dds::Publisher<dds::Signal> elsewhere(guest, "/PSM2/hold", dds::Role::kRequest);
    test::Eventually([&] { return participant_.num_found() > before; });
  }
  for (int i = 0; i < 5; ++i) Step(*driver);
  EXPECT_EQ(driver->phase(), PsmPhase::kArmed) << driver->Explain();
  for (const char* name : {"hold", "free", "state_command", "emulate_tool_present",
                           "use_gravity_compensation", "body/set_cf_orientation_absolute"}) {
    SCOPED_TRACE(name);
    const std::string topic = std::string("/PSM1/") + name;
    const dds::Publisher<dds::Text> publisher(guest, topic, dds::Role::kRequest);
    ExpectHolds(*driver, PsmStatus::kNewcomer);
    EXPECT_EQ(driver->who(), "'gu?[2Jest' at 127.0.0.1 publishes " + topic);
    ASSERT_EQ(driver->Requesters().size(), 1U);
    // Arms again in the presence of the participant.
    Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
  }
}

// An Si does not accept a Classic's instrument: an arm with such an instrument is a Classic in any
// configuration.
TEST_F(PsmDriverTest, AConfiguredSiIsNotArmedWithAClassicsInstrument) {
  PsmDriverOptions options;
  options.client.limits.generation = kinematics::PsmGeneration::kSi;
  const auto driver = Connected(options);
  EXPECT_EQ(BringUp(*driver, 5.0, {}, {}, InStep(*driver)), PsmStatus::kWrongTool);
  EXPECT_THAT(driver->Explain(), HasSubstr("of generation Si needs 420006"));
}

TEST_F(PsmDriverTest, HoldAndTheEndOfAnArmedDriverReachTheConsole) {
  auto driver = Armed();
  dds::Subscriber<dds::Signal> hold(server_participant_, "/PSM1/hold", dds::Role::kRequest);
  dds::Signal signal;
  const auto until_heard = [&] {
    Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
    driver->Hold();
    Tick(*driver);
    EXPECT_EQ(driver->status(), PsmStatus::kHeld);
    return hold.Take(signal);
  };
  test::Eventually(until_heard);
  Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
  while (hold.Take(signal)) {
  }
  ASSERT_EQ(driver->Request(PsmRequest::kDisable), PsmStatus::kOk);
  Tick(*driver);
  EXPECT_TRUE(hold.Take(signal) && !hold.Take(signal)) << "one hold, before the request";
  server_.TakeCommands();
  console_.Place(test::PsmHome());
  Until(*driver, [&] { return driver->Arm() == PsmStatus::kOk; });
  driver.reset();
  test::Eventually([&] { return hold.Take(signal); });
}

TEST(PsmDriverNoConsoleTest, ReportsAMissingConsole) {
  dds::Participant participant({.domain = test::OwnDomain()});
  PsmDriver driver(participant, {.arm = "PSM3"});
  std::int64_t now_ns = 0;
  const BringUpClock clock = {.steady_ns = [&] { return now_ns; },
                              .wall_ns = [&] { return now_ns; },
                              .wait = [&] { now_ns += 5'000'000; }};
  std::vector<std::string> said;
  EXPECT_EQ(BringUp(
                driver, 3.0, [&](std::string_view text) { said.emplace_back(text); }, {}, clock),
            PsmStatus::kNoConsole);
  EXPECT_THAT(said, testing::ElementsAre(HasSubstr("waiting: PSM3")));
  EXPECT_THAT(driver.Explain(), HasSubstr("start the console (or dvrk_simulator)"));
  EXPECT_THROW(PsmDriver(participant, {.arm = "/PSM1"}), std::invalid_argument);
}

// The server shows only publishers of topics to which this process subscribes.
TEST(PsmDriverServerTest, ADiscoveryServerShowsAllWhoCommandTheArm) {
  dds::ParticipantOptions options{.domain = test::OwnDomain()};
  options.server_port = static_cast<std::uint16_t>(11811 + test::OwnDomain());
  options.discovery = dds::Discovery::kServer;
  const dds::Participant server(options);
  options.discovery = dds::Discovery::kServerClient;
  dds::Participant participant(options);
  dds::Participant other(options);
  PsmDriver driver(participant, {});
  const std::vector<std::string> commands = {
      "servo_cp",      "servo_cr",         "servo_cv",     "servo_cf",     "servo_jp",   "servo_jr",
      "servo_jv",      "servo_jf",         "move_jp",      "move_jr",      "move_cp",    "move_cr",
      "body/servo_cf", "spatial/servo_cf", "jaw/servo_jp", "jaw/servo_jf", "jaw/move_jp"};
  const std::vector<std::string> requests = {"hold",
                                             "free",
                                             "state_command",
                                             "set_base_frame",
                                             "set_tool_type",
                                             "use_gravity_compensation",
                                             "emulate_tool_present",
                                             "emulate_adapter_present",
                                             "body/set_cf_orientation_absolute",
                                             "trajectory_j/set_ratio",
                                             "trajectory_j/set_ratio_a",
                                             "trajectory_j/set_ratio_v"};
  std::vector<std::unique_ptr<dds::Publisher<dds::Text>>> publishers;
  for (const auto* topics : {&commands, &requests}) {
    for (const std::string& topic : *topics) {
      publishers.push_back(std::make_unique<dds::Publisher<dds::Text>>(other, "/PSM1/" + topic,
                                                                       dds::Role::kRequest));
    }
  }
  test::Eventually([&] {
    driver.Tick();
    driver.Flush();
    return driver.other_publishers() == static_cast<int>(commands.size()) &&
           driver.Requesters().size() == requests.size();
  });
}

sim::PsmConsoleOptions Cart() {
  sim::PsmConsoleOptions options{.arm = "PSM1", .homing_s = 0.1};
  options.base_frame.translation() = Eigen::Vector3d(0.05, -0.1, 0.2);
  options.base_frame.linear() =
      Eigen::AngleAxisd(2.0, Eigen::Vector3d(1.0, -1.0, 0.5).normalized()).toRotationMatrix();
  options.base_frame_name = "ECM_view";
  return options;
}

// Poses are relative to a camera, and set-points are sent with their twist.
class PsmDriverOnCartTest : public PsmDriverTest {
 protected:
  PsmDriverOnCartTest() : PsmDriverTest(Cart()) {}
};

TEST_F(PsmDriverOnCartTest, MovesTheArmInItsOwnFrameByStatesWithTwists) {
  PsmDriverOptions options;
  options.servo_cs = true;
  dds::Subscriber<dds::CartesianState> heard(server_participant_, "/PSM1/servo_cs",
                                             dds::Role::kState);
  dds::Subscriber<dds::PoseStamped> poses(server_participant_, "/PSM1/servo_cp", dds::Role::kState);
  const auto driver = Armed(options);
  EXPECT_TRUE(
      test::AllClose(driver->client().base_frame().matrix(), Cart().base_frame.matrix(), 1e-9));
  // Discovery is complete by now: nothing more is sent on servo_cp.
  Until(*driver, [&] {
    dds::CartesianState state;
    return heard.TakeNewest(state) && state.pose_valid && state.twist_valid;
  });
  dds::PoseStamped pose;
  while (poses.Take(pose)) {
  }
  ASSERT_EQ(driver->MoveTo(Yaw(0.1), 1.0), PsmStatus::kOk);
  double fastest = 0.0;
  Until(*driver, [&] {
    dds::CartesianState state;
    while (heard.Take(state)) fastest = std::max(fastest, state.linear_m_s.norm());
    return driver->at_rest() || driver->phase() != PsmPhase::kArmed;
  });
  EXPECT_EQ(driver->status(), PsmStatus::kOk) << driver->Explain();
  Until(*driver, [&] { return test::AllClose(console_.setpoint_joints(), Yaw(0.1), 1e-9); });
  // The tip is 0.1135 m from the remote centre. In the middle, a move has 1.5 times its mean speed.
  EXPECT_NEAR(fastest, 1.5 * 0.1 * 0.1135, 1e-3);
  EXPECT_FALSE(poses.Take(pose)) << "poses are sent in addition";
}

}  // namespace
}  // namespace dfr::hardware
