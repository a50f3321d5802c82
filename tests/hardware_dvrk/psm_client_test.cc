#include "dfr/hardware/psm_client.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "tests/hardware_dvrk/psm_client_fixture.h"
#include "tests/support/all_close.h"
#include "tests/support/no_alloc.h"

namespace dfr::hardware {
namespace {

TEST_F(PsmClientTest, OnlyListensUntilArmed) {
  Become(PsmConsoleState::kEnabled, true, false);
  Steps(10);
  EXPECT_EQ(client_.phase(), PsmPhase::kIdle);
  EXPECT_EQ(client_.status(), PsmStatus::kOk);
  EXPECT_EQ(client_.MoveTo(Yaw(0.1), 5.0), PsmStatus::kNotArmed);
  EXPECT_EQ(client_.MoveJaw(0.2, 5.0), PsmStatus::kNotArmed);
  EXPECT_EQ(num_servo_ + num_holds_, 0);
  EXPECT_EQ(requests_, "");
}

TEST_F(PsmClientTest, MovesAndComesToRestAtTheGoal) {
  ArmNow();
  EXPECT_TRUE(client_.at_rest());
  ASSERT_EQ(client_.MoveTo(Yaw(0.1), 1.0), PsmStatus::kOk);
  EXPECT_FALSE(client_.at_rest());
  int steps = 0;
  for (; !client_.at_rest() && steps < 1000; ++steps) Step();
  EXPECT_TRUE(test::AllClose(at_, Yaw(0.1), 1e-9));
  // The move takes 1 s plus 0.1 s to settle. A sample arrives every second step.
  EXPECT_NEAR(steps, 200 + 20, 4);
  // While armed, the client repeats the set-point.
  const int sent = num_servo_;
  Steps(10);
  EXPECT_EQ(num_servo_, sent + 10);
}

TEST_F(PsmClientTest, LateStepsStretchTheMoveInsteadOfLeaping) {
  ArmNow();
  ASSERT_EQ(client_.MoveTo(Yaw(0.2), 2.0), PsmStatus::kOk);
  Steps(200);
  const double before = client_.setpoint()[0];
  now_ns_ += 30 * kMs;
  Step();
  // The set-point moves at most as far as in a step of 5 ms.
  EXPECT_LE(client_.setpoint()[0] - before, 0.005 * client_.motion().limits().max_speed[0]);
  EXPECT_EQ(client_.phase(), PsmPhase::kArmed);
}

TEST_F(PsmClientTest, RefusedGoalsChangeNothing) {
  ArmNow();
  EXPECT_EQ(client_.MoveTo(Yaw(1.7), 100.0), PsmStatus::kBeyondLimits);
  EXPECT_EQ(client_.MoveTo(Yaw(0.2), 0.1), PsmStatus::kTooFast);
  EXPECT_EQ(client_.MoveTo(Yaw(kNan), 1.0), PsmStatus::kInvalidGoal);
  EXPECT_EQ(client_.MoveJaw(2.0, 10.0), PsmStatus::kBeyondLimits);
  EXPECT_EQ(client_.MoveJaw(0.9, 0.1), PsmStatus::kTooFast);
  EXPECT_FALSE(client_.moving());
  Steps(10);
  EXPECT_EQ(client_.phase(), PsmPhase::kArmed);
  EXPECT_TRUE(test::AllClose(at_, test::PsmHome(), 1e-9));
}

TEST_F(PsmClientTest, JawTurnsAtConstantSpeedAndOnlyOnRequest) {
  ArmNow();
  EXPECT_FALSE(Step().servo_jaw);
  ASSERT_EQ(client_.MoveJaw(0.4, 1.0), PsmStatus::kOk);
  EXPECT_TRUE(client_.moving());
  Steps(100);
  EXPECT_NEAR(jaw_, 0.25, 1e-9);
  Steps(102);
  EXPECT_EQ(jaw_, 0.4);
  EXPECT_FALSE(client_.moving());
}

// The arm stays at its goal while the jaw turns for longer than reach_timeout_s. An arm that leaves
// its goal during that time causes a hold.
TEST_F(PsmClientTest, ALongJawMoveEndsAtItsGoal) {
  ArmNow();
  ASSERT_EQ(client_.MoveJaw(1.0, 3.0), PsmStatus::kOk);
  Steps(630);
  ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  EXPECT_EQ(jaw_, 1.0);
  EXPECT_TRUE(client_.at_rest());
  client_.Hold();
  Step();
  ArmNow();
  ASSERT_EQ(client_.MoveJaw(0.0, 3.0), PsmStatus::kOk);
  Steps(700);
  ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  ASSERT_EQ(client_.MoveJaw(1.0, 3.0), PsmStatus::kOk);
  const auto away = [](PsmInput& input) {
    if (input.measured_js) input.measured_js->position[2] += 0.0015;
  };
  for (int i = 0; i < 450; ++i) Step(away);
  EXPECT_EQ(client_.status(), PsmStatus::kNotReached) << Name(client_.status());
}

// A jaw that others have turned since the last sample would jump to the move's outdated start.
TEST_F(PsmClientTest, AJawWhoseSetpointIsSilentIsNotMoved) {
  const auto silent = [](PsmInput& input) { input.jaw_setpoint.reset(); };
  ArmNow();
  for (int i = 0; i < 40; ++i) Step(silent);
  ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  EXPECT_EQ(client_.MoveJaw(0.3, 1.0), PsmStatus::kStateSilent);
  for (int i = 0; i < 40; ++i)
    Step([](PsmInput& input) {
      if (input.jaw_setpoint) input.jaw_setpoint->stamp = {};
    });
  EXPECT_EQ(client_.MoveJaw(0.3, 1.0), PsmStatus::kStateInvalid) << "stamped zero";
  EXPECT_FALSE(Step().servo_jaw);
  Step();
  ASSERT_EQ(client_.MoveJaw(0.3, 1.0), PsmStatus::kOk);
  Steps(60);
  for (int i = 0; i < 9; ++i) Step(silent);
  ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  for (int i = 0; i < 4; ++i) Step(silent);
  EXPECT_EQ(client_.phase(), PsmPhase::kHolding);
  EXPECT_EQ(client_.status(), PsmStatus::kStateSilent) << Name(client_.status());
}

// A console whose jaw is frozen repeats the jaw's last sample.
TEST_F(PsmClientTest, AJawWhoseSetpointIsOldIsNotMoved) {
  const auto old = [](PsmInput& input) {
    if (input.jaw_setpoint) input.jaw_setpoint->stamp.sec -= 3;
  };
  ArmNow();
  for (int i = 0; i < 2; ++i) Step(old);
  ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  EXPECT_EQ(client_.MoveJaw(0.3, 1.0), PsmStatus::kStateOld);
  Steps(2);
  ASSERT_EQ(client_.MoveJaw(0.3, 1.0), PsmStatus::kOk);
  Steps(60);
  for (int i = 0; i < 2; ++i) Step(old);
  EXPECT_EQ(client_.phase(), PsmPhase::kHolding);
  EXPECT_EQ(client_.status(), PsmStatus::kStateOld) << Name(client_.status());
}

TEST_F(PsmClientTest, HoldWorksAtAnyTime) {
  client_.Hold();
  Step();
  EXPECT_EQ(client_.phase(), PsmPhase::kHolding);
  EXPECT_EQ(client_.status(), PsmStatus::kHeld);
  EXPECT_EQ(num_holds_, 1);
  ArmNow();
  ASSERT_EQ(client_.MoveTo(Yaw(0.2), 3.0), PsmStatus::kOk);
  Steps(100);
  client_.Hold();
  EXPECT_EQ(client_.MoveTo(Yaw(0.2), 3.0), PsmStatus::kNotArmed);
  EXPECT_EQ(client_.Arm(), PsmStatus::kOk);  // still armed: the hold follows in the next step
  EXPECT_FALSE(Step().servo);
  EXPECT_EQ(client_.status(), PsmStatus::kHeld);
}

TEST_F(PsmClientTest, EveryFaultHolds) {
  struct Fault {
    PsmStatus cause;
    std::function<void(PsmInput&)> spoil;
    int steps = 1;
    bool bound = false;
  };
  const auto joints = [](PsmStatus cause, const std::function<void(PsmJointSample&)>& spoil) {
    const auto spoil_sample = [spoil](PsmInput& in) {
      if (in.measured_js) spoil(*in.measured_js);
    };
    return Fault{cause, spoil_sample, 2};
  };
  const auto pose = [](PsmStatus cause, const std::function<void(PsmPoseSample&)>& spoil) {
    const auto spoil_sample = [spoil](PsmInput& in) {
      if (in.measured_cp) spoil(*in.measured_cp);
    };
    return Fault{cause, spoil_sample, 2};
  };
  const auto setpoint = [](PsmStatus cause, const std::function<void(PsmJointSample&)>& spoil,
                           int steps) {
    const auto spoil_sample = [spoil](PsmInput& in) {
      if (in.setpoint_js) spoil(*in.setpoint_js);
    };
    return Fault{cause, spoil_sample, steps};
  };
  std::optional<PsmJointSample> frozen;
  std::optional<dds::Stamp> frozen_stamp;
  const std::vector<Fault> faults = {
      setpoint(
          PsmStatus::kStateInvalid, [](auto& js) { js.stamp = {}; }, 2),
      setpoint(
          PsmStatus::kStateAhead, [](auto& js) { js.stamp.sec += 3; }, 2),
      setpoint(
          PsmStatus::kStateOld, [](auto& js) { js.stamp.sec -= 3; }, 2),
      setpoint(
          PsmStatus::kStateOld,
          [&](auto& js) {
            if (!frozen_stamp) frozen_stamp = js.stamp;
            js.stamp = *frozen_stamp;
          },
          13),
      joints(PsmStatus::kStateInvalid, [](auto& js) { js.stamp = {}; }),
      joints(PsmStatus::kStateAhead, [](auto& js) { js.stamp.sec += 3; }),
      joints(PsmStatus::kStateMalformed, [](auto& js) { js.well_formed = false; }),
      joints(PsmStatus::kStateJumped, [](auto& js) { js.position[1] += 0.05; }),
      pose(PsmStatus::kStateInvalid, [](auto& cp) { cp.stamp = {}; }),
      pose(PsmStatus::kStateNotFinite, [](auto& cp) { cp.position_m.y() = kNan; }),
      // A quaternion whose length is not 1, and a quaternion whose length overflows.
      pose(PsmStatus::kStateNotFinite, [](auto& cp) { cp.orientation.coeffs() *= 3.0; }),
      pose(PsmStatus::kStateNotFinite, [](auto& cp) { cp.orientation.coeffs() *= 1e200; }),
      pose(PsmStatus::kStateJumped, [](auto& cp) { cp.position_m.x() += 0.02; }),
      // At most 50 ms of silence, in steps of 5 ms. The last sample arrived one step earlier.
      {PsmStatus::kStateSilent,
       [](PsmInput& in) { in.measured_js.reset(), in.measured_cp.reset(); }, 11},
      {PsmStatus::kStateSilent, [](PsmInput& in) { in.measured_cp.reset(); }, 11},
      {PsmStatus::kStateSilent, [](PsmInput& in) { in.setpoint_js.reset(); }, 11},
      {PsmStatus::kStateSilent,
       [](PsmInput& in) {
         if (in.setpoint_js) in.setpoint_js->position[0] = kNan;
       },
       11},
      {PsmStatus::kConsoleGone,
       [](PsmInput& in) {
         in.measured_js.reset();
         in.measured_cp.reset();
         in.state_publishers = 0;
       },
       11},
      {PsmStatus::kStateOld,
       [&](PsmInput& in) {
         if (!frozen && in.measured_js) frozen = in.measured_js;
         if (in.measured_js) in.measured_js = frozen;
       },
       13},
      // A set-point that the console moves by itself is detected within 2 mm, before the lag
      // reaches 5 degrees.
      {PsmStatus::kForeignSetpoint,
       [](PsmInput& in) {
         if (in.setpoint_js) in.setpoint_js->position[1] += 0.015;
       },
       2, /*bound=*/true},
      {PsmStatus::kConsoleError, [](PsmInput& in) { in.errors = 1; }},
      {PsmStatus::kOtherPublisher, [](PsmInput& in) { in.other_publishers = 1; }},
      {PsmStatus::kSecondConsole, [](PsmInput& in) { in.state_publishers = 2; }},
      {PsmStatus::kForeignMessage, [](PsmInput& in) { in.foreign_messages = 1; }},
      {PsmStatus::kNewcomer, [](PsmInput& in) { in.newcomers = 1; }},
      {PsmStatus::kBusy, [](PsmInput& in) { in.goals_reached = 1; }},
      {PsmStatus::kTeleoperated, [](PsmInput& in) { in.teleoperated = true; }},
      {PsmStatus::kClutched, [](PsmInput& in) { in.clutched = true; }},
      {PsmStatus::kWrongTool, [](PsmInput& in) { in.instrument = PsmInstrument::kOther; }},
      {PsmStatus::kToolNotNamed, [](PsmInput& in) { in.instrument = PsmInstrument::kNotNamed; }},
      {PsmStatus::kToolChanged, [](PsmInput& in) { in.tool_changes = 1; }},
      {PsmStatus::kSendFailed, [](PsmInput& in) { in.send_failed = true; }},
      // The move ends after 559 steps, and the client then waits for 2 s, 400 steps.
      {PsmStatus::kNotReached,
       [this](PsmInput& in) {
         if (in.measured_js) in.measured_js->position[0] += num_steps_ % 4 == 0 ? 0.011 : 0.012;
       },
       559 + 401}};
  for (const Fault& fault : faults) ExpectHold(fault.cause, fault.spoil, fault.steps, fault.bound);
}

TEST_F(PsmClientTest, AConsoleThatIsNotReadyHolds) {
  const auto holds = [&](PsmStatus cause, PsmConsoleState state, bool homed, bool busy) {
    ExpectHold(cause, [&](PsmInput& input) {
      Become(state, homed, busy);
      input.operating_state = operating_;
    });
  };
  holds(PsmStatus::kConsoleFault, PsmConsoleState::kFault, true, false);
  holds(PsmStatus::kPaused, PsmConsoleState::kPaused, true, false);
  holds(PsmStatus::kDisabled, PsmConsoleState::kDisabled, true, false);
  holds(PsmStatus::kNotHomed, PsmConsoleState::kEnabled, false, false);
  holds(PsmStatus::kBusy, PsmConsoleState::kEnabled, true, true);
  // FAULT and ENABLED both arrive before the client's next step.
  ExpectHold(PsmStatus::kConsoleFault, [&](PsmInput& input) {
    Become(PsmConsoleState::kFault, true, false);
    Become(PsmConsoleState::kEnabled, true, false);
    input.operating_state = operating_;
  });
}

// Other clients turn the jaw before and after a jaw move of this client.
TEST_F(PsmClientTest, MeasurementsAreCheckedThoughTheArmIsNotReady) {
  Become(PsmConsoleState::kDisabled, true, false);
  for (int i = 0; i < 40; ++i) Step([](PsmInput& input) { input.setpoint_js.reset(); });
  EXPECT_EQ(client_.MeasurementHoldReason(), PsmStatus::kOk);
  for (int i = 0; i < 2; ++i) {
    Step([](PsmInput& input) {
      if (input.measured_js) input.measured_js->stamp = {};
    });
  }
  EXPECT_EQ(client_.MeasurementHoldReason(), PsmStatus::kStateInvalid);
  EXPECT_EQ(client_.hold_reason(), PsmStatus::kDisabled);
}

TEST_F(PsmClientTest, AJawThatOthersTurnHolds) {
  const auto turned = [](PsmInput& input) {
    if (input.jaw_setpoint) input.jaw_setpoint->angle += 0.1;
  };
  ExpectHold(PsmStatus::kForeignSetpoint, turned, 2, /*bound=*/true);
  ASSERT_EQ(client_.MoveJaw(jaw_ + 0.2, 1.0), PsmStatus::kOk);
  Steps(300);
  ASSERT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
  Step(turned);
  Step(turned);
  EXPECT_EQ(client_.status(), PsmStatus::kForeignSetpoint) << Name(client_.status());
}

// Arming at an earlier set-point would move the arm back to it.
TEST_F(PsmClientTest, IsNotArmedAtAnEarlierSetpoint) {
  Become(PsmConsoleState::kEnabled, true, false);
  Steps(4);
  at_ = Yaw(0.05);
  for (int i = 0; i < 20; ++i) Step([](PsmInput& input) { input.setpoint_js.reset(); });
  EXPECT_EQ(client_.Arm(), PsmStatus::kStateSilent);
  Steps(2);
  EXPECT_EQ(client_.Arm(), PsmStatus::kOk);
  EXPECT_TRUE(test::AllClose(client_.setpoint(), Yaw(0.05), 1e-9));
  for (int i = 0; i < 2; ++i) {
    Step([](PsmInput& input) {
      if (input.setpoint_js) input.setpoint_js->stamp.sec -= 3;
    });
  }
  EXPECT_EQ(client_.status(), PsmStatus::kStateOld) << Name(client_.status());
  EXPECT_EQ(client_.Arm(), PsmStatus::kStateOld);
}

TEST_F(PsmClientTest, LateSetpointsAreOurs) {
  ArmNow();
  ASSERT_EQ(client_.MoveTo(Yaw(0.2), 1.0), PsmStatus::kOk);
  std::vector<PsmJoints> before;
  for (int i = 0; i < 200; ++i) {
    before.push_back(at_);
    Step([&](PsmInput& input) {
      if (!input.setpoint_js) return;
      // The set-points are 140 ms late, at nearly the fastest speed of a move.
      input.setpoint_js->position = before[static_cast<std::size_t>(std::max(0, i - 28))];
    });
  }
  EXPECT_EQ(client_.phase(), PsmPhase::kArmed) << Name(client_.status());
}
TEST_F(PsmClientTest, LoopThatStoodStillHolds) {
  ExpectHold(PsmStatus::kTickLate, [&](PsmInput& input) {
    // No other input is late: the samples are current.
    now_ns_ += 200 * kMs;
    input = Input();
    num_steps_ -= num_steps_ % 2;
    input = Input();
  });
}
TEST_F(PsmClientTest, ArmThatStaysBehindHolds) {
  // The arm stops, and the set-point moves on: the lag exceeds the limit of 0.09 rad.
  ExpectHold(
      PsmStatus::kNotFollowing,
      [&, stuck = std::optional<PsmJointSample>()](PsmInput& input) mutable {
        if (!stuck && input.measured_js) stuck = input.measured_js;
        if (!input.measured_js) return;
        input.measured_js->position = stuck->position;
        const Eigen::Isometry3d pose = Psm::Forward(stuck->position);
        input.measured_cp->position_m = pose.translation();
      },
      400, /*bound=*/true);
}
TEST_F(PsmClientTest, OtherCommandersArePermittedByAnOption) {
  PsmClientOptions options;
  options.sole_commander = false;
  client_ = PsmClient(options);
  ArmNow();
  Step([](PsmInput& input) { input.other_publishers = 3; });
  EXPECT_EQ(client_.status(), PsmStatus::kOk);
}

TEST_F(PsmClientTest, ArmRefusesAnotherFrameOrInstrument) {
  Become(PsmConsoleState::kEnabled, true, false);
  for (int i = 0; i < 4; ++i) {
    Step([](PsmInput& input) {
      if (input.measured_cp) input.measured_cp->position_m.z() -= 0.003;
    });
  }
  EXPECT_EQ(client_.status(), PsmStatus::kOk);
  EXPECT_EQ(client_.Arm(), PsmStatus::kFrameMismatch);
  for (int i = 0; i < 4; ++i) {
    Step([](PsmInput& input) {
      if (input.measured_cp) input.measured_cp->orientation = Eigen::Quaterniond(1, 0, 0, 0);
    });
  }
  EXPECT_EQ(client_.Arm(), PsmStatus::kFrameMismatch);
  EXPECT_EQ(client_.phase(), PsmPhase::kIdle);
}

TEST_F(PsmClientTest, ArmReportsTheReason) {
  EXPECT_EQ(client_.Arm(), PsmStatus::kNoConsole);
  Step([](PsmInput& input) { input = {}; });
  EXPECT_EQ(client_.Arm(), PsmStatus::kNoConsole);
  Step([](PsmInput& input) {
    input = {};
    input.incompatible = 1;
  });
  EXPECT_EQ(client_.Arm(), PsmStatus::kIncompatible);
  Step([](PsmInput& input) { input.operating_state.reset(); });
  EXPECT_EQ(client_.Arm(), PsmStatus::kNoOperatingState);
  Become(PsmConsoleState::kDisabled, false, false);
  Steps(2);
  EXPECT_EQ(client_.Arm(), PsmStatus::kDisabled);
  Become(PsmConsoleState::kUnknown, false, false);
  Steps(2);
  EXPECT_EQ(client_.Arm(), PsmStatus::kUnknownState);
  Become(PsmConsoleState::kEnabled, true, false);
  Steps(3);
  Step([](PsmInput& input) { input.instrument = PsmInstrument::kNotNamed; });
  EXPECT_EQ(client_.Arm(), PsmStatus::kToolNotNamed);
}

// Consoles may omit velocities, which are then computed from the positions.
TEST_F(PsmClientTest, MissingVelocitiesAreComputedFromPositions) {
  ArmNow();
  ASSERT_EQ(client_.MoveTo(Yaw(0.2), 2.0), PsmStatus::kOk);
  for (int i = 0; i < 200; ++i) {
    Step([](PsmInput& input) {
      if (input.measured_js) input.measured_js->has_velocity = false;
    });
  }
  // The move is halfway along its profile s^2 (3 - 2 s).
  EXPECT_NEAR(client_.measured_js().velocity[0], 1.5 * 0.2 / 2.0, 1e-3);
}

TEST_F(PsmClientTest, NeverAllocates) {
  ArmNow();
  const PsmInput input = Input();
  const test::NoAlloc guard;
  (void)client_.MoveTo(Yaw(0.3), 3.0);
  (void)client_.MoveTo(Yaw(0.2), 3.0);
  (void)client_.MoveJaw(0.2, 3.0);
  (void)client_.Step(input, now_ns_, kWall + now_ns_);
  client_.Hold();
  (void)client_.Step(input, now_ns_, kWall + now_ns_);
  (void)client_.Arm();
  (void)client_.Request(PsmRequest::kHome);
  (void)client_.Step(input, now_ns_, kWall + now_ns_);
}

}  // namespace
}  // namespace dfr::hardware
