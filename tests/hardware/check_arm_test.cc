#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <functional>
#include <mutex>
#include <string>
#include <thread>

#include "check.h"
#include "dfr/dds/channel.h"
#include "dfr/dds/emergency_stop.h"
#include "dfr/sim/dvrk/psm_console_server.h"
#include "tests/dds/domain.h"
#include "tests/hardware/check_support.h"

namespace dfr::apps::hardware_app {
namespace {

using Clock = std::chrono::steady_clock;
using test::Background;
using test::ForArm;
using test::Shown;
using testing::AllOf;
using testing::HasSubstr;

class ArmCheckTest : public testing::Test {
 public:
  explicit ArmCheckTest(kinematics::PsmGeneration generation = kinematics::PsmGeneration::kClassic)
      : console_{{.arm = "PSM1", .homing_s = 0.1, .generation = generation}} {}

 protected:
  void Change(const std::function<void()>& change) {
    const std::lock_guard lock(mutex_);
    change();
  }

  std::mutex mutex_;
  sim::PsmConsole console_;
  dds::Participant participant_{{.domain = test::OwnDomain()}};
  sim::PsmConsoleServer server_{participant_, console_};
  Clock::time_point last_ = Clock::now();
  Background background_{[this] {
    const auto now = Clock::now();
    const std::lock_guard lock(mutex_);
    server_.Tick(std::min(0.05, std::chrono::duration<double>(now - last_).count()));
    last_ = now;
  }};
};

TEST_F(ArmCheckTest, FindsTheConsoleAndSaysToHome) {
  const DeviceReport report = CheckArm(ForArm());
  EXPECT_FALSE(report.ok());
  EXPECT_THAT(Shown(report), AllOf(HasSubstr("6 of the console's topics found"),
                                   HasSubstr("[wrong] the arm is DISABLED"), HasSubstr("--home")));
}

TEST_F(ArmCheckTest, HomesAndMovesOnlyAfterAsking) {
  CheckOptions options = ForArm();
  options.home = options.move = options.without_stop = true;
  int asked = 0;
  options.ask = [&](const std::string&) {
    ++asked;
    return false;
  };
  EXPECT_FALSE(CheckArm(options).ok());
  EXPECT_EQ(asked, 1);
  Change([&] { EXPECT_FALSE(console_.homed()); });
  options.ask = [&](const std::string&) {
    ++asked;
    return true;
  };
  const DeviceReport report = CheckArm(options);
  EXPECT_TRUE(report.ok()) << Shown(report);
  EXPECT_EQ(asked, 3);
  EXPECT_THAT(Shown(report), HasSubstr("told to insert by 2.0 mm, the arm moved"));
  Change([&] { EXPECT_NEAR(console_.setpoint_joints()[2], 0.12, 1e-9); });
}

class SiArmCheckTest : public ArmCheckTest {
 protected:
  SiArmCheckTest() : ArmCheckTest(kinematics::PsmGeneration::kSi) {}
};

TEST_F(SiArmCheckTest, IsMovedWithinItsOwnLimits) {
  Change([&] {
    kinematics::PsmJoints joints = kinematics::PsmJoints::Zero();
    joints[1] = 1.2;  // where no Classic can be
    joints[2] = 0.12;
    console_.Place(joints);
  });
  CheckOptions options = ForArm();
  options.move = options.without_stop = true;
  options.ask = [](const std::string&) { return true; };
  EXPECT_THAT(Shown(CheckArm(options)),
              AllOf(HasSubstr("a move of 2 mm is refused"), HasSubstr("--generation Si")));
  options.generation = kinematics::PsmGeneration::kSi;
  const DeviceReport report = CheckArm(options);
  EXPECT_TRUE(report.ok()) << Shown(report);
  EXPECT_THAT(Shown(report), HasSubstr("the arm moved"));
}

TEST_F(ArmCheckTest, MovesNothingWithoutAnEmergencyStopThatIsReleased) {
  CheckOptions options = ForArm("PSM1", 2.0);
  options.home = options.move = true;
  options.ask = [](const std::string&) { return true; };
  EXPECT_THAT(Shown(CheckArm(options)), HasSubstr("nothing is heard of an emergency stop"));
  dds::EmergencyStopButton button(participant_);
  std::atomic<bool> pressed = true;
  const Background beats([&] {
    if (pressed != button.pressed()) pressed ? button.Press() : button.Release();
    button.Beat();
  });
  EXPECT_THAT(Shown(CheckArm(options)), HasSubstr("the emergency stop is pressed"));
  Change([&] { EXPECT_EQ(console_.state(), sim::ArmState::kDisabled); });
  pressed = false;
  EXPECT_TRUE(CheckArm(options).ok());
}

TEST_F(ArmCheckTest, AStopThatIsPressedEndsHoming) {
  Change([&] { console_ = sim::PsmConsole({.arm = "PSM1", .homing_s = 30.0}); });
  CheckOptions options = ForArm();
  options.home = true;
  options.ask = [](const std::string&) { return true; };
  dds::EmergencyStopButton button(participant_);
  const Background beats([&] {
    bool homes = false;
    Change([&] { homes = console_.busy(); });
    if (homes) button.Press();
    button.Beat();
  });
  EXPECT_THAT(Shown(CheckArm(options)), HasSubstr("the emergency stop is pressed, or was"));
  for (int i = 0; i < 1000; ++i) {
    bool disabled = false;
    Change([&] { disabled = console_.state() == sim::ArmState::kDisabled; });
    if (disabled) return;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  ADD_FAILURE() << "it homes on";
}

TEST_F(ArmCheckTest, NamesFaultInTheConsolesWords) {
  Change([&] {
    console_.StateCommand("home");
    console_.Fail("the brake is stuck");
  });
  EXPECT_THAT(Shown(CheckArm(ForArm())),
              AllOf(HasSubstr("FAULT"), HasSubstr("\"PSM1: the brake is stuck\""),
                    HasSubstr("disable, home")));
}

TEST_F(ArmCheckTest, NamesWhatIsWrongWithTheSamples) {
  Change([&] { console_.StateCommand("home"); });
  std::this_thread::sleep_for(std::chrono::milliseconds(300));
  sim::ConsoleFaults faults;
  faults.delay_s = 1.0;
  Change([&] { server_.SetFaults(faults); });
  EXPECT_THAT(Shown(CheckArm(ForArm())), HasSubstr("s behind this machine's clock"));
  faults = {};
  faults.invalid = true;
  Change([&] { server_.SetFaults(faults); });
  EXPECT_THAT(Shown(CheckArm(ForArm())), HasSubstr("stamped zero though the arm is homed"));
  faults = {};
  faults.corrupt = true;
  Change([&] { server_.SetFaults(faults); });
  EXPECT_THAT(Shown(CheckArm(ForArm())), HasSubstr("not finite"));
  faults = {};
  faults.drop = 0.9;
  Change([&] { server_.SetFaults(faults); });
  EXPECT_THAT(Shown(CheckArm(ForArm())), HasSubstr("a console publishes 100 times"));
}

TEST_F(ArmCheckTest, NamesOtherClientsAndASecondConsole) {
  Change([&] { console_.StateCommand("home"); });
  const dds::Publisher<dds::PoseStamped> other(participant_, "/PSM1/servo_cp", dds::Role::kCommand);
  const dds::Publisher<dds::JointState> console(participant_, "/PSM1/measured_js",
                                                dds::Role::kState);
  EXPECT_THAT(Shown(CheckArm(ForArm())),
              AllOf(HasSubstr("someone else can command the arm"),
                    HasSubstr("2 publishers on /PSM1/measured_js"), HasSubstr("but one")));
}

TEST_F(ArmCheckTest, AnotherArmsNameIsNamed) {
  EXPECT_THAT(Shown(CheckArm(ForArm("PSM2", 1.0))),
              AllOf(HasSubstr("nobody publishes /PSM2/measured_js"), HasSubstr("there is PSM1")));
}

}  // namespace
}  // namespace dfr::apps::hardware_app
