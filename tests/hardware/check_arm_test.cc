// The check of an arm with a simulated console, without a network and without a clock.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <functional>
#include <limits>
#include <string>

#include "check/check.h"
#include "dfr/sim/dvrk/psm_console.h"
#include "tests/hardware/check_support.h"
#include "tests/hardware_dvrk/console_topics.h"
#include "tests/kinematics/psm_home.h"

namespace dfr::apps::hardware_app {
namespace {

using hardware::PsmPhase;
using hardware::PsmStatus;
using test::Shown;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

// A driver's client, connected directly to a console.
class FakeCheckedArm final : public CheckedArm {
 public:
  explicit FakeCheckedArm(test::HandMovedClock& clock, const sim::PsmConsoleOptions& options,
                          kinematics::PsmGeneration generation)
      : console(options),
        clock_(&clock),
        client_({.limits = hardware::PsmLimits::Of(generation)}),
        last_ns_(clock.now_ns) {}

  void Tick(std::int64_t steady_ns, std::int64_t wall_ns) override {
    console.Step(1e-9 * static_cast<double>(steady_ns - last_ns_));
    last_ns_ = steady_ns;
    hardware::PsmInput input;
    input.state_publishers = topics_[0].health.publishers;
    input.other_publishers = others;
    input.command_subscribers = 1;
    input.instrument = hardware::PsmInstrument::kSuitable;
    for (const sim::ConsoleMessage& message : console.TakeMessages()) {
      if (message.severity != sim::ConsoleMessage::Severity::kError) continue;
      last_error_ = message.text;
      ++input.errors;
    }
    read_.ReadState(console, input);
    if (ticks_++ % ticks_a_sample == 0) read_.Measure(console, wall_ns, input);
    if (spoil) spoil(input);
    const hardware::PsmOutput output = client_.Step(input, steady_ns, wall_ns);
    if (output.hold) console.Hold();
    if (output.request != hardware::PsmRequest::kNone) {
      console.StateCommand(hardware::Name(output.request));
    }
    if (output.servo) console.ServoCp(output.servo_cp);
  }
  const hardware::PsmClient& client() const override { return client_; }
  bool TakeMessage(hardware::ConsoleMessage& /*message*/) override { return false; }
  std::string_view last_error() const override { return last_error_; }
  int other_publishers() const override { return others; }
  int state_publishers() const override { return topics_[0].health.publishers; }
  int servo_subscribers() const override { return listens ? 1 : 0; }
  int request_subscribers() const override { return listens ? 1 : 0; }
  std::array<Topic, 6> topics() const override { return topics_; }
  PsmStatus Arm() override { return client_.Arm(); }
  PsmStatus MoveTo(const kinematics::PsmJoints& goal, double duration_s) override {
    return client_.MoveTo(goal, duration_s);
  }
  void Hold() override { client_.Hold(); }
  void Flush() override {}
  PsmStatus BringUp(double timeout_s, const std::function<void(std::string_view)>& /*say*/,
                    const std::function<bool()>& may_move) override {
    static_cast<void>(client_.Request(hardware::PsmRequest::kHome));
    PsmStatus armed = PsmStatus::kTimedOut;
    static_cast<void>(Within(*clock_, timeout_s, [&] {
      const bool stopped = !may_move();
      if (stopped) client_.Hold();
      Tick(clock_->SteadyNs(), clock_->WallNs());
      if (stopped) armed = PsmStatus::kHeld;
      if (!stopped && client_.phase() != PsmPhase::kRequested) armed = client_.Arm();
      return stopped || armed == PsmStatus::kOk || armed == PsmStatus::kFrameMismatch;
    }));
    return armed;
  }
  StopLook Stop(std::int64_t /*steady_ns*/) override { return stop(); }

  dds::Health& health(std::size_t topic) { return topics_[topic].health; }

  sim::PsmConsole console;
  std::function<void(hardware::PsmInput&)> spoil;
  std::function<StopLook()> stop = [] { return dds::EmergencyStop::kSilent; };
  int ticks_a_sample = 2;
  int others = 0;
  bool listens = true;

 private:
  test::HandMovedClock* clock_;
  hardware::PsmClient client_;
  std::int64_t last_ns_;
  test::ConsoleTopics read_;
  std::string last_error_;
  int ticks_ = 0;
  std::array<Topic, 6> topics_ = {{{"measured_js", {.publishers = 1}, true},
                                   {"measured_cp", {.publishers = 1}, true},
                                   {"setpoint_js", {.publishers = 1}, true},
                                   {"operating_state", {.publishers = 1}, true},
                                   {"jaw/measured_js", {.publishers = 1}, false},
                                   {"error", {.publishers = 1}, false}}};
};

class ArmCheckTest : public testing::Test {
 protected:
  explicit ArmCheckTest(kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic)
      : generation_(generation) {
    options_.arm = "PSM1";
    options_.clock = &clock_;
    options_.ask = [this](const std::string&) { return ++asked_ > 0; };
  }
  void Home() {
    arm_.console.StateCommand("home");
    arm_.console.Settle();
  }
  std::string Check() { return Shown(CheckArm(options_, arm_)); }

  kinematics::PsmGeneration generation_;
  test::HandMovedClock clock_;
  CheckOptions options_;
  int asked_ = 0;
  FakeCheckedArm arm_{clock_, {.homing_s = 1.0, .generation = generation_}, generation_};
};

TEST_F(ArmCheckTest, FindsTheConsoleAndSaysToHome) {
  const DeviceReport report = CheckArm(options_, arm_);
  EXPECT_FALSE(report.ok());
  EXPECT_THAT(Shown(report), AllOf(HasSubstr("6 of the console's topics found"),
                                   HasSubstr("measured_js arrives 100 times a second"),
                                   HasSubstr("[wrong] the arm is DISABLED"), HasSubstr("--home")));
}

TEST_F(ArmCheckTest, HomesAndMovesOnlyAfterAsking) {
  options_.home = options_.move = options_.without_stop = true;
  options_.ask = [this](const std::string&) { return ++asked_ > 1; };
  EXPECT_FALSE(CheckArm(options_, arm_).ok());
  EXPECT_EQ(asked_, 1);
  EXPECT_EQ(arm_.console.state(), sim::ArmState::kDisabled);
  const DeviceReport report = CheckArm(options_, arm_);
  EXPECT_TRUE(report.ok()) << Shown(report);
  EXPECT_EQ(asked_, 3);
  EXPECT_THAT(Shown(report), HasSubstr("told to insert by 2.0 mm, the arm moved"));
  EXPECT_NEAR(arm_.console.setpoint_joints()[2], 0.12, 1e-9);
}

TEST_F(ArmCheckTest, WarnsFirstOfAMissingEmergencyStop) {
  const auto first = [this] {
    const Finding finding = CheckArm(options_, arm_).findings.front();
    return finding.level == Finding::Level::kNote ? finding.what : std::string();
  };
  EXPECT_THAT(first(), HasSubstr("NO EMERGENCY STOP was found"));
  arm_.stop = [] { return dds::EmergencyStop::kClear; };
  EXPECT_EQ(first(), "");
  options_.without_stop = true;
  EXPECT_THAT(first(), HasSubstr("WITHOUT AN EMERGENCY STOP"));
}

TEST_F(ArmCheckTest, MovesNothingWithoutAReleasedEmergencyStop) {
  options_.home = options_.move = true;
  EXPECT_THAT(Check(), HasSubstr("no emergency stop was found"));
  arm_.stop = [] { return StopLook(dds::EmergencyStop::kSilent, true); };
  EXPECT_THAT(Check(), AllOf(HasSubstr("over DDS, but not by datagram"),
                             HasSubstr("give --no-datagrams"), Not(HasSubstr("--without-stop"))));
  arm_.stop = [] { return dds::EmergencyStop::kPressed; };
  EXPECT_THAT(Check(), HasSubstr("the emergency stop is pressed"));
  EXPECT_EQ(arm_.console.state(), sim::ArmState::kDisabled);
  arm_.stop = [] { return dds::EmergencyStop::kClear; };
  EXPECT_THAT(Check(), HasSubstr("the arm moved"));
}

TEST_F(ArmCheckTest, APressedStopEndsHoming) {
  options_.home = options_.move = true;
  arm_.stop = [this] {
    return arm_.console.busy() ? dds::EmergencyStop::kPressed : dds::EmergencyStop::kClear;
  };
  EXPECT_FALSE(CheckArm(options_, arm_).ok());
  EXPECT_EQ(arm_.console.state(), sim::ArmState::kDisabled);
  EXPECT_FALSE(arm_.console.homed());
  EXPECT_EQ(asked_, 1) << "the arm is not moved then";
}

TEST_F(ArmCheckTest, AStopOrAnInterruptEndsTheMove) {
  Home();
  options_.move = true;
  std::atomic<bool> interrupted = false;
  options_.interrupted = &interrupted;
  const auto moves = [this] { return arm_.console.setpoint_joints()[2] > 0.1205; };
  bool pressed = false;
  arm_.stop = [&] {
    pressed = pressed || moves();
    return pressed ? dds::EmergencyStop::kPressed : dds::EmergencyStop::kClear;
  };
  EXPECT_THAT(Check(), HasSubstr("the emergency stop is pressed, or was"));
  EXPECT_LT(arm_.console.setpoint_joints()[2], 0.121) << "the arm moved on";
  arm_.console.Place(test::PsmHome());
  arm_.stop = [&] {
    interrupted = interrupted || moves();
    return dds::EmergencyStop::kClear;
  };
  EXPECT_THAT(Check(), HasSubstr("interrupted: nothing is moved further"));
  EXPECT_LT(arm_.console.setpoint_joints()[2], 0.121) << "the arm moved on";
}

// A stop that is silent only for a moment is still the cause.
TEST_F(ArmCheckTest, AShortSilenceOfTheStopIsNamed) {
  for (const bool homing : {true, false}) {
    arm_.console = sim::PsmConsole({.homing_s = 1.0});
    if (!homing) Home();
    options_.home = homing;
    options_.move = !homing;
    int looks = 0;
    asked_ = 0;
    arm_.stop = [&] {
      const bool moves = arm_.console.busy() || arm_.console.setpoint_joints()[2] > 0.1205;
      return asked_ > 0 && moves && ++looks == 20 ? dds::EmergencyStop::kSilent
                                                  : dds::EmergencyStop::kClear;
    };
    EXPECT_THAT(Check(), AllOf(HasSubstr("the emergency stop became silent"),
                               Not(HasSubstr("held on request"))));
  }
}

// The arm homes, but its measurements contradict each other.
TEST_F(ArmCheckTest, AnArmThatIsHomedButNotArmedIsWrong) {
  options_.home = options_.without_stop = true;
  arm_.spoil = [](hardware::PsmInput& input) {
    if (input.measured_cp) input.measured_cp->position_m.x() += 0.01;
  };
  EXPECT_THAT(Check(),
              AllOf(HasSubstr(std::string("[wrong] ") + hardware::Name(PsmStatus::kFrameMismatch)),
                    Not(HasSubstr("ENABLED and homed"))));
  EXPECT_TRUE(arm_.console.homed());
}

TEST_F(ArmCheckTest, QuotesTheConsolesFault) {
  Home();
  arm_.console.Fail("the brake is stuck");
  EXPECT_THAT(Check(), AllOf(HasSubstr("FAULT"), HasSubstr("\"PSM1: the brake is stuck\""),
                             HasSubstr("disable, home")));
}

TEST_F(ArmCheckTest, NamesWhatIsWrongWithTheSamples) {
  Home();
  const auto of_joints = [this](const auto& spoil) {
    arm_.spoil = [spoil](hardware::PsmInput& input) {
      if (input.measured_js) spoil(*input.measured_js);
    };
  };
  for (const auto& [off_ns, words] : {std::pair(-1'000'000'000, "1.000 s behind this machine's"),
                                      std::pair(500'000'000, "0.500 s ahead of this machine's")}) {
    of_joints([off = off_ns](hardware::PsmJointSample& js) {
      js.stamp = dds::Stamp::FromNanoseconds(js.stamp.nanoseconds() + off);
    });
    EXPECT_THAT(Check(), HasSubstr(words));
  }
  of_joints([](hardware::PsmJointSample& js) { js.stamp = {}; });
  EXPECT_THAT(Check(), HasSubstr("stamped zero though the arm is homed"));
  of_joints([](hardware::PsmJointSample& js) {
    js.position[3] = std::numeric_limits<double>::quiet_NaN();
  });
  EXPECT_THAT(Check(), HasSubstr("not finite"));
  of_joints([](hardware::PsmJointSample& js) { js.well_formed = false; });
  EXPECT_THAT(Check(), HasSubstr(hardware::Name(PsmStatus::kStateMalformed)));
  arm_.spoil = {};
  arm_.ticks_a_sample = 20;
  EXPECT_THAT(Check(), AllOf(HasSubstr("measured_js arrives 10 times a second"),
                             HasSubstr("a console publishes 100 times")));
}

TEST_F(ArmCheckTest, NamesWhatIsWrongOnTheNetwork) {
  Home();
  arm_.others = 1;
  arm_.listens = false;
  arm_.health(0).publishers = 2;
  arm_.health(1).publishers = 0;
  arm_.health(3) = {.incompatible = 1};
  arm_.health(4).publishers = 0;
  EXPECT_THAT(Check(), AllOf(HasSubstr("others can command the arm"),
                             HasSubstr("2 publishers on /PSM1/measured_js"), HasSubstr("but one"),
                             HasSubstr("[wrong] no program publishes /PSM1/measured_cp"),
                             HasSubstr("a publisher on /PSM1/operating_state does not match (QoS)"),
                             HasSubstr("[note]  no program publishes /PSM1/jaw/measured_js"),
                             HasSubstr("no program subscribes to state_command")));
}

class SiArmCheckTest : public ArmCheckTest {
 protected:
  SiArmCheckTest() : ArmCheckTest(kinematics::PsmGeneration::kSi) {
    arm_.console.Place(test::PsmHomeWith(1, 1.2));  // outside the range of a Classic
    options_.move = options_.without_stop = true;
  }
};

TEST_F(SiArmCheckTest, IsMovedWithinItsOwnLimits) {
  EXPECT_THAT(Check(), HasSubstr("the arm moved"));
  FakeCheckedArm classic(clock_, {.generation = generation_}, kinematics::PsmGeneration::kClassic);
  classic.console.Place(arm_.console.measured_joints());
  EXPECT_THAT(Shown(CheckArm(options_, classic)),
              AllOf(HasSubstr("a move of 2 mm is refused"), HasSubstr("--generation Si")));
}

}  // namespace
}  // namespace dfr::apps::hardware_app
