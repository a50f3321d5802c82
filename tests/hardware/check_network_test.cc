// The checks over a real network and port.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <utility>

#include "check/check.h"
#include "dfr/core/error.h"
#include "dfr/core/random.h"
#include "dfr/dds/channel.h"
#include "dfr/sim/dvrk/psm_console_server.h"
#include "home.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/hardware/check_support.h"
#include "tests/hardware_stewart/sprk_emulator.h"

namespace dfr::apps::hardware_app {
namespace {

using test::Shown;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr double kForEver = 1e9;  // s

// The clock starts and stops when the check prints the texts `starts_` and `stops_`. Each Wait()
// runs the test's action.
class NetworkCheckTest : public testing::Test {
 protected:
  NetworkCheckTest() {
    options_.network.domain = domain_;
    options_.clock = &clock_;
    options_.find_s = options_.listen_s = 0.1;
    options_.say = [this](const std::string& text) {
      if (text.starts_with(starts_)) clock_.stands = false;
      if (text.starts_with(stops_)) clock_.stands = true;
    };
    clock_.waits = [this] {
      if (goes_on) goes_on();
      (void)::poll(nullptr, 0, 1);
    };
  }

  const int domain_ = test::OwnDomain();
  dds::Participant participant_{{.domain = domain_}};
  test::HandMovedClock clock_;
  CheckOptions options_;
  std::string starts_ = "never";
  std::string stops_ = "never";
  std::function<void()> goes_on;
};

TEST_F(NetworkCheckTest, NamesTheProgramToStartIfNoneIsFound) {
  options_.arm = "PSM1";
  const DeviceReport report = CheckArm(options_);
  EXPECT_FALSE(report.ok());
  EXPECT_THAT(Shown(report), AllOf(HasSubstr("no program publishes /PSM1/measured_js"),
                                   HasSubstr("dvrk_simulator"),
                                   HasSubstr("ROS_DOMAIN_ID must be " + std::to_string(domain_))));
}

TEST_F(NetworkCheckTest, SuggestsTheNameOfAnotherArm) {
  const dds::Publisher<dds::JointState> other(participant_, "/PSM1/measured_js", dds::Role::kState);
  options_.arm = "PSM2";
  stops_ = "looking for other arms";
  EXPECT_THAT(Shown(CheckArm(options_)), AllOf(HasSubstr("no program publishes /PSM2/measured_js"),
                                               HasSubstr("there is PSM1")));
}

TEST_F(NetworkCheckTest, FindsTheConsolesTopics) {
  sim::PsmConsole console({.arm = "PSM1"});
  sim::PsmConsoleServer server(participant_, console);
  goes_on = [&] { server.Tick(0.005); };
  options_.arm = "PSM1";
  stops_ = "looking for PSM1";
  starts_ = "listening";
  EXPECT_THAT(Shown(CheckArm(options_)),
              AllOf(HasSubstr("6 of the console's topics found"),
                    HasSubstr("the console subscribes to state_command and servo_cp"),
                    Not(HasSubstr("others can command"))));
}

TEST_F(NetworkCheckTest, FindsTheEndoscopesTopic) {
  dds::Publisher<dds::Image> publisher(participant_, "/ECM/image_raw", dds::Role::kImage);
  core::Random random(5);
  options_.endoscope = "/ECM/image_raw";
  EXPECT_THAT(Shown(CheckEndoscope(options_)),
              HasSubstr("[wrong] no program publishes pictures on /ECM/image_raw"));
  goes_on = [&] {
    dds::Image image;
    image.stamp = dds::Stamp::Now();
    image.width = 64;
    image.height = 48;
    image.encoding = "bgr8";
    image.step = 192;
    image.data.resize(std::size_t{48} * 192);
    for (auto& value : image.data) value = static_cast<std::uint8_t>(100 + random.Below(50));
    (void)publisher.Write(image);
  };
  options_.find_s = kForEver;
  EXPECT_THAT(Shown(CheckEndoscope(options_)),
              HasSubstr("pictures have 64 x 48 pixels, the intrinsics are for 640 x 480"));
}

class PlatformMoveCheckTest : public testing::Test {
 protected:
  PlatformMoveCheckTest() {
    options_.platform = emulator_.device();
    options_.clock = &clock_;
    options_.move = true;
    options_.interrupted = &interrupted_;
    options_.ask = [](const std::string&) { return true; };
    options_.network.domain = test::OwnDomain();
    options_.find_s = 0.1;
  }
  std::string Check() {
    return Shown(CheckPlatform(options_, [this](std::int64_t) { return stop_; }));
  }
  // Runs `happens` when this time has passed since the first wait.
  void After(double seconds, std::function<void()> happens) {
    const auto then_ns = clock_.now_ns + static_cast<std::int64_t>(1e9 * seconds);
    clock_.waits = [this, then_ns, happens = std::move(happens)] {
      if (clock_.now_ns >= then_ns) happens();
    };
  }
  static double TiltOf(const test::SprkFirmware::Command& command) {
    return command.Pose().angles_rad.x() / 0.017453292519943295;
  }

  test::SprkEmulator emulator_;
  test::HandMovedClock clock_;
  CheckOptions options_;
  std::atomic<bool> interrupted_ = false;
  dds::EmergencyStop stop_ = dds::EmergencyStop::kClear;
};

TEST_F(PlatformMoveCheckTest, OpensThePortAndMovesOnlyAfterAsking) {
  options_.move = false;
  EXPECT_THAT(Check(), AllOf(HasSubstr("never answers"), Not(HasSubstr("[wrong]"))));
  options_.move = true;
  const std::int64_t start_ns = clock_.now_ns;
  EXPECT_THAT(Check(), AllOf(HasSubstr("was told to go home"), Not(HasSubstr("[wrong]"))));
  EXPECT_GE(1e-9 * static_cast<double>(clock_.now_ns - start_ns), 3 * 1.5)
      << "time for each motion";
  const auto commands = emulator_.Await(3);
  ASSERT_EQ(commands.size(), 3U);
  EXPECT_EQ(commands[0].letter, 'h');
  EXPECT_NEAR(TiltOf(commands[1]), 3.0, 1e-9);
  EXPECT_NEAR(TiltOf(commands[2]), 0.0, 1e-9);
}

TEST_F(PlatformMoveCheckTest, MovesNothingWithoutAReleasedStopOrAfterAnInterruptOrAnError) {
  for (const auto& [stop, words] :
       {std::pair(dds::EmergencyStop::kSilent, "no emergency stop was found"),
        std::pair(dds::EmergencyStop::kPressed, "the emergency stop is pressed")}) {
    stop_ = stop;
    EXPECT_THAT(Check(), HasSubstr(words));
  }
  EXPECT_EQ(RunCheck(options_), 1) << "there is no stop";
  stop_ = dds::EmergencyStop::kClear;
  interrupted_ = true;
  EXPECT_THAT(Check(), HasSubstr("interrupted"));
  options_.without_stop = true;
  EXPECT_EQ(RunCheck(options_), 1);
  interrupted_ = false;
  options_.endoscope = "/dev/video97";
  EXPECT_EQ(RunCheck(options_), 1) << "the endoscope is missing";
  options_.endoscope.clear();
  EXPECT_EQ(RunCheck(options_), 0);
  EXPECT_EQ(emulator_.Await(3).size(), 3U) << "only the last check moves it";
}

TEST_F(PlatformMoveCheckTest, AStopOrAnInterruptHoldsThePlatform) {
  After(1.6, [this] { stop_ = dds::EmergencyStop::kPressed; });
  EXPECT_THAT(Check(), AllOf(HasSubstr("the emergency stop is pressed, or was"),
                             Not(HasSubstr("was told to go home"))));
  ASSERT_EQ(emulator_.Await(3).size(), 3U);  // opening the port again discards unread frames
  stop_ = dds::EmergencyStop::kClear;
  After(1.6, [this] { interrupted_ = true; });
  EXPECT_THAT(Check(), HasSubstr("interrupted"));
  const auto commands = emulator_.Await(6);
  ASSERT_EQ(commands.size(), 6U);
  for (const std::size_t last : {2U, 5U}) {
    EXPECT_EQ(commands[last].letter, 'a');
    EXPECT_NEAR(TiltOf(commands[last]), 1.0, 1.0) << "on the way";
    EXPECT_GT(TiltOf(commands[last]), 0.5);
  }
}

TEST_F(PlatformMoveCheckTest, AStopDuringTheFirstHomingSaysThatOnlyThePowerStopsIt) {
  After(0.5, [this] { stop_ = dds::EmergencyStop::kPressed; });
  EXPECT_THAT(Check(),
              AllOf(HasSubstr("the emergency stop is pressed, or was"),
                    HasSubstr("continues to its home position"), HasSubstr("cut its power")));
  const auto commands = emulator_.Await(2);
  ASSERT_EQ(commands.size(), 2U);
  EXPECT_NEAR(TiltOf(commands[1]), 0.0, 1e-9);
}

class PlatformHomeTest : public testing::Test {
 protected:
  // Returns output and exit code.
  std::pair<std::string, int> Home(const std::string& answer) {
    std::string said;
    HomeOptions options;
    options.platform = emulator_.device();
    options.confirms = [&](const std::string& question, const std::string& word) {
      EXPECT_THAT(question, HasSubstr(emulator_.device()));
      return answer == word;
    };
    options.say = [&](const std::string& text) { said += text; };
    options.interrupted = &interrupted_;
    options.clock = &clock_;
    const int code = RunHome(options);
    return {said, code};
  }

  test::SprkEmulator emulator_;
  test::HandMovedClock clock_;
  std::atomic<bool> interrupted_ = false;
};

TEST_F(PlatformHomeTest, MovesOnlyOnTheOperatorsWord) {
  for (const char* answer : {"", "y", "yes", "home"}) EXPECT_EQ(Home(answer).second, 1) << answer;
  const auto [said, code] = Home("platform");
  EXPECT_EQ(code, 0);
  EXPECT_THAT(said, HasSubstr("check its position"));
  const auto commands = emulator_.Await(1);
  ASSERT_EQ(commands.size(), 1U);
  EXPECT_EQ(commands[0].letter, 'h');
}

TEST_F(PlatformHomeTest, CtrlCEndsTheWaitAndSaysWhatStopsThePlatform) {
  clock_.waits = [this] { interrupted_ = true; };
  const auto [said, code] = Home("platform");
  EXPECT_EQ(code, 1);
  EXPECT_THAT(said,
              AllOf(HasSubstr("continues to its home position"), HasSubstr("cutting its power")));
  EXPECT_EQ(emulator_.Await(1).size(), 1U);
}

TEST_F(PlatformHomeTest, APortThatFailsIsNamed) {
  HomeOptions options;
  options.platform = emulator_.device();
  options.clock = &clock_;
  options.confirms = [&](const std::string&, const std::string&) {
    emulator_.Unplug();
    return true;
  };
  try {
    RunHome(options);
    ADD_FAILURE() << "it went home";
  } catch (const core::Error& e) {
    EXPECT_THAT(e.what(), AllOf(HasSubstr(emulator_.device()), HasSubstr("cut its power")));
  }
}

// Without a terminal the operator cannot have typed the word.
TEST_F(PlatformHomeTest, NothingMovesWithoutATerminal) {
  const std::string command =
      std::string("echo platform | " DFR_HARDWARE " home --platform ") + emulator_.device();
  EXPECT_EQ(test::PeerProcess({"/bin/sh", "-c", command}).Await(), 1);
  EXPECT_EQ(Home("platform").second, 0);
  EXPECT_EQ(emulator_.Await(1).size(), 1U) << "only the second command moves it";
}

TEST(CheckProgramTest, ExitCodeReportsErrors) {
  test::SprkEmulator emulator;
  const auto run = [](std::vector<std::string> arguments) {
    arguments.insert(arguments.begin(), {DFR_HARDWARE, "check"});
    return test::PeerProcess(arguments).Await();
  };
  EXPECT_EQ(run({"--platform", emulator.device(), "--generation", "Si"}), 0);
  EXPECT_EQ(run({"--platform", "/dev/none"}), 1);
  EXPECT_GT(run({"--generation", "Xi"}), 1);
}

}  // namespace
}  // namespace dfr::apps::hardware_app
