// Line tracking over the network, in lock-step with the simulator, compared with line tracking in
// one process; the run as a program; the platform of a run, on an emulator's port; its terminal.
#include "simulator/lock_step.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "dfr/hardware/psm_driver.h"
#include "dfr/recording/read_recording.h"
#include "robot/robot_plant.h"
#include "robot/terminal.h"
#include "simulator/simulator_link.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/dds/security/keystore.h"
#include "tests/hardware_stewart/sprk_emulator.h"
#include "tests/line_tracking/lock_step_config.h"
#include "tests/line_tracking/model_folder.h"
#include "tests/support/message_of.h"
#include "tests/support/temp_folder.h"

namespace dfr::apps::line_tracking {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

// Takes 4 s, because it draws every picture of an episode. Only this test compares the robot's loop
// over DDS with the plant in one process.
TEST(LockStepTest, TheSameSeedsHaveTheSameOutcomesAsInOneProcess) {
  const int domain = test::OwnDomain();
  const line_task::LineCalibration known = Data().Calibration();
  const test::PeerProcess simulator({DFR_SIMULATOR, "--lock-step", "--domain",
                                     std::to_string(domain), "--wave", "random", "--calibration",
                                     (Data().path / "calibration.dfr").string()});
  sim::LineTrackingPlant here(Disturbed(), &known);
  // The simulator of one arm does not prove that another arm is simulated.
  RobotConfig other = LockStepConfig(domain);
  other.arm = "PSM2";
  EXPECT_THAT(
      test::MessageOf<std::runtime_error>([&] { const RobotPlant plant(other, known, nullptr); }),
      HasSubstr("has the arm PSM1, not PSM2"));
  RobotPlant there(LockStepConfig(domain), known, nullptr);
  there.BringUp({});
  const LineModel model = LineModel::Load(Data().path / "model");
  // Episodes of these methods are short.
  for (const auto& [method, outcome] : {std::pair("baseline", core::Outcome::kCompleted),
                                        std::pair("early-stopping", core::Outcome::kHalted)}) {
    SCOPED_TRACE(method);
    const std::unique_ptr<control::Controller> controller = model.MakeController(method);
    const Ending in_process = Episode(here, *controller, 0);
    EXPECT_EQ(in_process.outcome, outcome);
    const Ending over_the_wire = Episode(there, *controller, 0);
    EXPECT_EQ(over_the_wire, in_process)
        << "here " << core::Name(in_process.outcome) << ", there "
        << core::Name(over_the_wire.outcome) << ' ' << control::Name(over_the_wire.cause);
  }
}

// Takes 5 s, because it starts four programs. Only this test finds a program that `launch` starts
// without its certificate.
TEST(LaunchTest, AllStartedProgramsJoinTheSecuredNetwork) {
  const test::Keystore keys = {{"line_tracking", dds::Permission::kController},
                               {"dvrk_simulator", dds::Permission::kConsole},
                               {"stop", dds::Permission::kButton}};
  const std::filesystem::path config = Data().path / "secured.toml";
  const std::filesystem::path recordings = Data().path / "secured";
  std::ofstream(config) << "robot = 'dds'\nmethod = 'early-stopping'\nmodel = '"
                        << (Data().path / "model").string() << "'\ncalibration = '"
                        << (Data().path / "calibration.dfr").string() << "'\nrecordings = '"
                        << recordings.string() << "'\n[network]\ndomain = " << test::OwnDomain()
                        << "\nsecurity = '" << keys.enclave("line_tracking").string()
                        << "'\n[simulator]\npresent = true\nlock_step = true\nanswer_s = 86400.0\n"
                           "[emergency_stop]\nmax_silence_s = 10.0\n";
  const std::filesystem::path out = Data().path / "launch.txt";
  test::PeerProcess launch({"/bin/sh", "-c",
                            "exec '" DFR_LINE_TRACKING "' launch --episodes 1 --config '" +
                                config.string() + "' > '" + out.string() + "' 2>&1"});
  ASSERT_EQ(launch.Await(), 0);
  EXPECT_THAT(test::FileText(out),
              AllOf(HasSubstr("-> armed"), Not(HasSubstr("WITHOUT AN EMERGENCY STOP"))));
  ASSERT_TRUE(std::filesystem::exists(recordings));
  const recording::Recording log =
      recording::ReadRecording(std::filesystem::directory_iterator(recordings)->path());
  EXPECT_GT(log.steps.size(), 0U);
  EXPECT_EQ(log.metadata.more.at("emergency stop"), "required");
}

int Count(const std::string& printed, const std::string& text) {
  int count = 0;
  for (std::size_t at = printed.find(text); at != std::string::npos;
       at = printed.find(text, at + 1)) {
    ++count;
  }
  return count;
}

// Takes 4 s, because it runs two episodes in lock-step. Only this test reads the operator's output
// of a whole run. LaunchTest has a run with an emergency stop.
TEST(WithoutStopTest, ARunWarnsAtEveryStartAndInItsRecording) {
  const std::string warning =
      "WITHOUT AN EMERGENCY STOP: only the console and Ctrl-C here stop the arm\n";
  const std::filesystem::path folder = Data().path / "run-without-stop";
  std::filesystem::create_directories(folder);
  const int domain = test::OwnDomain();
  std::ofstream(folder / "run.toml")
      << "robot = 'dds'\nmethod = 'early-stopping'\nmodel = '" << (Data().path / "model").string()
      << "'\ncalibration = '" << (Data().path / "calibration.dfr").string() << "'\nrecordings = '"
      << (folder / "log").string() << "'\n[network]\ndomain = " << domain
      << "\n[simulator]\npresent = true\nlock_step = true\nanswer_s = 86400.0\n"
         "[emergency_stop]\nrequired = false\n[loop]\npriority = 0\n";
  const test::PeerProcess simulator(
      {DFR_SIMULATOR, "--lock-step", "--domain", std::to_string(domain)});
  const std::filesystem::path out = folder / "out.txt";
  test::PeerProcess run({"/bin/sh", "-c",
                         "exec '" DFR_LINE_TRACKING "' run --episodes 2 --config '" +
                             (folder / "run.toml").string() + "' > '" + out.string() + "'"});
  const int code = run.Await();
  const std::string printed = test::FileText(out);
  ASSERT_EQ(code, 0) << printed;
  EXPECT_TRUE(printed.starts_with(warning)) << printed;
  const int starts = Count(printed, "-> armed");
  EXPECT_GE(starts, 2) << printed;
  EXPECT_EQ(Count(printed, "  " + warning), starts) << printed;
  const recording::Recording log =
      recording::ReadRecording(std::filesystem::directory_iterator(folder / "log")->path());
  EXPECT_EQ(log.metadata.more.at("emergency stop"), "none");
}

// No simulator answers. Both kinds of requests time out, and the loop continues.
TEST(SimulatorLinkTest, AnUnansweredRequestTimesOut) {
  dds::Participant network({.domain = test::OwnDomain()});
  std::int64_t now_ns = 0;
  const std::int64_t step_ns = 500'000'000;
  SimulatorLink link(network, 5.0, [&] { return now_ns += step_ns; });
  SimulatorTruth truth;
  int periods = 0;
  EXPECT_FALSE(link.Truth(truth, [&periods] { return ++periods != 3; }))
      << "the third period ends the wait";
  EXPECT_EQ(periods, 3);
  const std::function<void()> ways[] = {
      [&] { static_cast<void>(link.Truth(truth, [&periods] { return ++periods > 0; })); },
      [&] { static_cast<void>(link.Truth()); }};
  for (const auto& ask : ways) {
    const std::int64_t start_ns = now_ns;
    EXPECT_EQ(test::MessageOf<std::runtime_error>(ask), "the simulator does not answer 'truth'");
    EXPECT_GE(now_ns - start_ns, 5'000'000'000);
    EXPECT_LE(now_ns - start_ns, 5'000'000'000 + 2 * step_ns);
  }
  EXPECT_GE(periods, 3 + 10);
}

// A loop that holds also requests rest and pictures. After one unanswered request it must not wait
// for the other requests.
TEST(LockStepTest, AfterAnUnansweredRequestNothingWaitsUntilRetry) {
  dds::Participant network({.domain = test::OwnDomain()});
  hardware::PsmDriver driver(network, {});
  std::int64_t now_ns = 0;
  SimulatorLink link(network, 5.0, [&] { return now_ns += 500'000'000; });
  LockStep clock(link, driver);
  const std::function<robot::Finding()> ways[] = {[&] { return clock.Wait(0.005); },
                                                  [&] { return clock.Rest(); },
                                                  [&] { return clock.Look(); }};
  for (const auto& first : ways) {
    clock.Retry();
    const std::int64_t start_ns = now_ns;
    EXPECT_FALSE(first().ok());
    EXPECT_GE(now_ns - start_ns, 5'000'000'000);
    for (const auto& later : ways) {
      const std::int64_t before_ns = now_ns;
      EXPECT_FALSE(later().ok());
      EXPECT_EQ(now_ns, before_ns) << "it asks";
    }
  }
}

class PlatformTest : public testing::Test {
 protected:
  [[nodiscard]] RobotConfig Robot() const {
    RobotConfig config = LockStepConfig(domain_);
    config.platform.device = port_.device();
    config.platform.wave = hardware::SprkWaveKind::kSine;
    config.platform.motion.amplitude.translation_m.x() = 0.00254;
    config.platform.motion.frequency_hz[0] = 0.1;
    return config;
  }
  // Returns the letters of the first `count` commands.
  [[nodiscard]] std::string Arrived(std::size_t count) {
    std::string letters;
    for (const auto& command : port_.Await(count)) letters += command.letter;
    return letters;
  }

  int domain_ = test::OwnDomain();
  test::PeerProcess simulator_{
      std::vector<std::string>{DFR_SIMULATOR, "--lock-step", "--domain", std::to_string(domain_)}};
  test::SprkEmulator port_;
};

TEST_F(PlatformTest, MovesOnTheOperatorsWordAndRestsWhenTheRobotHolds) {
  {
    RobotPlant robot(Robot(), Data().Calibration(), nullptr);
    EXPECT_THROW(robot.BringUp({}), std::runtime_error) << "no operator confirmed it";
    std::string asked;
    const auto refuses = [&](std::string_view question, std::string_view word) {
      asked = std::string(question) + "|" + std::string(word);
      return false;
    };
    EXPECT_THROW(robot.BringUp({}, refuses), std::runtime_error);
    EXPECT_THAT(asked, HasSubstr("type platform|platform"));
    EXPECT_EQ(Arrived(0), "");
    robot.BringUp({}, Agrees());
    EXPECT_EQ(Arrived(2), "ha") << "home, and rests there";

    robot.Reset(1);
    EXPECT_EQ(Arrived(3), "hac") << "the wave of the episode";
    ASSERT_EQ(robot.Apply(std::array{0.3, 0.0}), core::PlantStatus::kOk) << robot.loop().cause();
    EXPECT_EQ(Arrived(0), "hac");
    robot.loop().Hold(runtime::HoldReason::kImageOld);
    EXPECT_EQ(Arrived(4), "haca") << "at once, without another period";
    robot.Halt();
    EXPECT_EQ(Arrived(0), "haca") << "it rests already";
    ASSERT_TRUE(robot.Clear());
    robot.Reset(2);
    EXPECT_EQ(Arrived(5), "hacac");
  }
  EXPECT_EQ(Arrived(6), "hacaca") << "the program ended in the middle of an episode";
  EXPECT_EQ(port_.Await(0).back().Pose().translation_m.x(), 0.0) << "the middle of the wave";
}

// Otherwise a closed terminal or a lost connection would end the program before it holds the robot.
TEST(TerminalTest, AClosedTerminalInterruptsAndAClosedPipeDoesNotEndTheProgram) {
  EXPECT_EXIT(
      {
        Terminal terminal;
        std::raise(SIGPIPE);
        if (Terminal::interrupted()) std::_Exit(2);
        std::raise(SIGHUP);
        std::_Exit(Terminal::interrupted() ? EXIT_SUCCESS : EXIT_FAILURE);
      },
      testing::ExitedWithCode(EXIT_SUCCESS), "");
}

}  // namespace
}  // namespace dfr::apps::line_tracking
