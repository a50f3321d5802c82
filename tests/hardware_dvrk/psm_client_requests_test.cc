#include <gtest/gtest.h>

#include <functional>
#include <initializer_list>
#include <limits>
#include <stdexcept>
#include <vector>

#include "dfr/hardware/psm_client.h"
#include "tests/hardware_dvrk/psm_client_fixture.h"
#include "until_sent.h"

namespace dfr::hardware {
namespace {

using PsmClientRequestTest = PsmClientTest;

TEST_F(PsmClientRequestTest, HomingIsRequestedOnceAndEndsInIdle) {
  Become(PsmConsoleState::kDisabled, false, false);
  Steps(4);
  ASSERT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kOk);
  EXPECT_EQ(client_.phase(), PsmPhase::kRequested);
  Steps(2);
  Become(PsmConsoleState::kEnabled, false, true);
  Steps(2000);  // 10 s
  EXPECT_EQ(client_.phase(), PsmPhase::kRequested);
  EXPECT_EQ(requests_, "home ");
  Become(PsmConsoleState::kEnabled, true, false);
  Steps(2);
  EXPECT_EQ(client_.phase(), PsmPhase::kIdle);
  EXPECT_EQ(client_.status(), PsmStatus::kOk);
  EXPECT_EQ(num_servo_, 0);
}

TEST_F(PsmClientRequestTest, UnansweredRequestsAreRepeatedAndTimeOut) {
  Become(PsmConsoleState::kDisabled, false, false);
  Steps(4);
  ASSERT_EQ(client_.Request(PsmRequest::kEnable), PsmStatus::kOk);
  Steps(1990);
  EXPECT_EQ(requests_, "enable enable enable enable enable ");  // every 2 s
  EXPECT_EQ(client_.phase(), PsmPhase::kRequested);
  Steps(20);
  EXPECT_EQ(client_.phase(), PsmPhase::kHolding);
  EXPECT_EQ(client_.status(), PsmStatus::kTimedOut);
}

TEST_F(PsmClientRequestTest, ARequestBeforeTheFirstStepHasItsFullTime) {
  now_ns_ = 1000 * 1000 * kMs;  // simulates a machine that has run for a quarter of an hour
  Become(PsmConsoleState::kDisabled, false, false);
  ASSERT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kOk);
  Steps(2);
  EXPECT_EQ(client_.phase(), PsmPhase::kRequested) << Name(client_.status());
}

TEST_F(PsmClientRequestTest, RequestWaitsForTheConsoleToListen) {
  ASSERT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kOk);
  for (int i = 0; i < 10; ++i) Step([](PsmInput& input) { input.command_subscribers = 0; });
  EXPECT_EQ(requests_, "");
  Step();
  EXPECT_EQ(requests_, "home ");
}

TEST_F(PsmClientRequestTest, AFaultEndsHomingAndPermitsOnlyDisable) {
  Become(PsmConsoleState::kEnabled, false, true);
  Steps(4);
  ASSERT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kOk);
  Steps(2);
  Become(PsmConsoleState::kFault, false, false);
  Steps(2);
  EXPECT_EQ(client_.status(), PsmStatus::kConsoleFault);
  EXPECT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kConsoleFault);
  EXPECT_EQ(client_.Request(PsmRequest::kDisable), PsmStatus::kOk);
  Steps(2);
  EXPECT_EQ(client_.phase(), PsmPhase::kIdle);
  EXPECT_EQ(requests_, "home disable ");
}

// A console may name the instrument only once homing has engaged it.
TEST_F(PsmClientRequestTest, HomingNeedsNoNamedInstrument) {
  const auto not_named = [](PsmInput& input) { input.instrument = PsmInstrument::kNotNamed; };
  Become(PsmConsoleState::kDisabled, false, false);
  for (int i = 0; i < 4; ++i) Step(not_named);
  ASSERT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kOk);
  for (int i = 0; i < 2; ++i) Step(not_named);
  Become(PsmConsoleState::kEnabled, false, true);
  for (int i = 0; i < 20; ++i) Step(not_named);
  EXPECT_TRUE(client_.homing()) << Name(client_.status());
}

// `hold` does not end a console's homing: `disable` does.
TEST_F(PsmClientRequestTest, AnyInterruptionEndsHoming) {
  const auto quiet = [](PsmInput& input) {
    input.measured_js.reset();
    input.measured_cp.reset();
  };
  struct Doubt {
    PsmStatus cause;
    std::function<void(PsmInput&)> spoil;
    int steps;
  };
  const std::vector<Doubt> doubts = {
      {PsmStatus::kHeld, [this](PsmInput&) { client_.Hold(); }, 1},
      {PsmStatus::kOtherPublisher, [](PsmInput& input) { input.other_publishers = 1; }, 1},
      {PsmStatus::kNewcomer, [](PsmInput& input) { input.newcomers = 1; }, 1},
      {PsmStatus::kStateSilent, quiet, 12},
      {PsmStatus::kTickLate, [this](PsmInput&) { now_ns_ += 200 * kMs; }, 2},
      {PsmStatus::kPaused,
       [](PsmInput& input) {
         input.operating_state.emplace();
         input.operating_state->state = PsmConsoleState::kPaused;
       },
       1},
      // An operator has switched the arm off.
      {PsmStatus::kDisabled,
       [](PsmInput& input) {
         input.operating_state.emplace();
         input.operating_state->state = PsmConsoleState::kDisabled;
       },
       1},
      {PsmStatus::kSendFailed, [](PsmInput& input) { input.send_failed = true; }, 1}};
  for (const Doubt& doubt : doubts) {
    SCOPED_TRACE(Name(doubt.cause));
    Become(PsmConsoleState::kDisabled, false, false);
    Steps(4);
    ASSERT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kOk);
    Steps(2);
    Become(PsmConsoleState::kEnabled, false, true);
    Steps(20);
    ASSERT_TRUE(client_.homing()) << Name(client_.status());
    num_holds_ = 0;
    requests_.clear();
    for (int i = 0; i < doubt.steps && client_.phase() == PsmPhase::kRequested; ++i) {
      Step(doubt.spoil);
    }
    ASSERT_EQ(client_.phase(), PsmPhase::kHolding);
    EXPECT_EQ(client_.status(), doubt.cause) << Name(client_.status());
    EXPECT_EQ(num_holds_, 1);
    EXPECT_EQ(requests_, "disable ");
    Steps(1000);
    EXPECT_EQ(requests_, "disable ") << "no further request is sent";
  }
}

TEST_F(PsmClientRequestTest, HomingIsNotRequestedWhenAnotherCommands) {
  Become(PsmConsoleState::kDisabled, false, false);
  Steps(4);
  ASSERT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kOk);
  Step([](PsmInput& input) { input.other_publishers = 1; });
  EXPECT_EQ(client_.status(), PsmStatus::kOtherPublisher);
  Steps(10);
  EXPECT_EQ(requests_, "");
}

TEST_F(PsmClientRequestTest, HomingTimesOut) {
  Become(PsmConsoleState::kDisabled, false, false);
  Steps(4);
  ASSERT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kOk);
  Steps(2);
  Become(PsmConsoleState::kEnabled, false, true);
  Steps(18'010);  // 90 s
  EXPECT_EQ(client_.status(), PsmStatus::kTimedOut);
  EXPECT_EQ(requests_, "home disable ");
}

TEST_F(PsmClientRequestTest, ARequestHoldsFirst) {
  ArmNow();
  ASSERT_EQ(client_.MoveTo(Yaw(0.2), 3.0), PsmStatus::kOk);
  Steps(20);
  ASSERT_EQ(client_.Request(PsmRequest::kDisable), PsmStatus::kOk);
  const PsmOutput output = Step();
  EXPECT_TRUE(output.hold);
  EXPECT_FALSE(output.servo);
  EXPECT_EQ(output.request, PsmRequest::kDisable);
}

// A newly discovered participant may have publishers that are still unknown.
TEST_F(PsmClientRequestTest, IsNeitherArmedNorHomedBeforeDiscoveryIsQuiet) {
  Become(PsmConsoleState::kEnabled, true, false);
  Steps(4);
  Step([](PsmInput& input) { input.newcomers = 1; });
  EXPECT_EQ(client_.Arm(), PsmStatus::kNewcomer);
  Steps(98);
  EXPECT_EQ(client_.Arm(), PsmStatus::kNewcomer);
  Steps(3);
  Become(PsmConsoleState::kDisabled, false, false);
  Step([](PsmInput& input) { input.newcomers = 1; });
  ASSERT_EQ(client_.Request(PsmRequest::kHome), PsmStatus::kOk);
  Steps(95);
  EXPECT_EQ(requests_, "");
  Steps(10);
  EXPECT_EQ(requests_, "home ");
}

TEST(UntilSentTest, AMessageIsWantedUntilAWriteSucceeds) {
  internal::UntilSent hold;
  int writes = 0;
  bool works = false;
  const auto write = [&] {
    ++writes;
    return works;
  };
  EXPECT_TRUE(hold.Send(write));
  EXPECT_EQ(writes, 0) << "not wanted";
  hold.Want();
  for (int attempt = 1; attempt <= 3; ++attempt) {
    EXPECT_FALSE(hold.Send(write));
    EXPECT_TRUE(hold.wanted());
    EXPECT_EQ(writes, attempt);
  }
  works = true;
  EXPECT_TRUE(hold.Send(write));
  EXPECT_FALSE(hold.wanted());
  EXPECT_TRUE(hold.Send(write));
  EXPECT_EQ(writes, 4) << "it is sent once";
}

// A call of Want() during the write requests another message.
TEST(UntilSentTest, ARequestDuringAWriteIsKept) {
  internal::UntilSent hold;
  hold.Want();
  EXPECT_TRUE(hold.Send([&] {
    hold.Want();
    return true;
  }));
  EXPECT_TRUE(hold.wanted());
}

TEST(PsmStatusTest, EveryStatusHasANameARemedyAndAReason) {
  EXPECT_EQ(HoldReasonFor(PsmStatus::kOk), runtime::HoldReason::kNone);
  EXPECT_EQ(HoldReasonFor(PsmStatus::kStateAhead), runtime::HoldReason::kClock);
  EXPECT_EQ(HoldReasonFor(PsmStatus::kForeignControl), runtime::HoldReason::kSecondCommander);
  EXPECT_EQ(HoldReasonFor(PsmStatus::kTooFast), runtime::HoldReason::kCommandRefused);
  for (int i = 1; i <= static_cast<int>(PsmStatus::kTooFast); ++i) {
    const auto status = static_cast<PsmStatus>(i);
    EXPECT_STRNE(Name(status), "") << i;
    EXPECT_STRNE(Remedy(status), "") << Name(status);
    EXPECT_NE(HoldReasonFor(status), runtime::HoldReason::kNone) << Name(status);
    for (int j = 0; j < i; ++j) EXPECT_STRNE(Name(status), Name(static_cast<PsmStatus>(j)));
  }
}

TEST(PsmClientOptionsTest, OptionsOutOfRangeAreRefused) {
  using Change = void (*)(PsmClientOptions&);
  for (const Change change : std::initializer_list<Change>{
           [](auto& o) { o.longest_step_s = 0.0; }, [](auto& o) { o.max_lag[2] = -1.0; },
           [](auto& o) { o.watchdog.max_age_s = std::numeric_limits<double>::quiet_NaN(); }}) {
    PsmClientOptions options;
    change(options);
    EXPECT_THROW(PsmClient{options}, std::invalid_argument);
  }
}

}  // namespace
}  // namespace dfr::hardware
