// Line tracking over the network against line tracking in one process, and what is left of a run.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "commands.h"
#include "dfr/control/rollout.h"
#include "dfr/core/random.h"
#include "dfr/dds/emergency_stop.h"
#include "dfr/recording/read_recording.h"
#include "emergency_stop_monitor.h"
#include "recorded_controller.h"
#include "robot_plant.h"
#include "simulator_link.h"
#include "tests/dds/domain.h"
#include "tests/dds/keystore.h"
#include "tests/dds/peer_process.h"
#include "tests/hardware_stewart/sprk_emulator.h"
#include "tests/line_tracking/scene.h"
#include "tests/support/no_alloc.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

// A folder with model and calibration, for all tests; it goes with the last of them.
class Folder {
 public:
  Folder() {
    std::filesystem::create_directories(path);
    calibration::CalibrationSummary summary;
    CalibratePlant(Disturbed(), 60, 3, &summary).Save(path / "calibration.dfr");
    LineModelOptions options;
    options.hidden = {8};
    options.gammas = {0.5};
    LineModel::Fit(Demonstrate(FromTruth(), Calibration(), 20, 50, 1), options)
        .Save(path / "model");
  }
  ~Folder() { std::filesystem::remove_all(path); }
  [[nodiscard]] line_task::LineCalibration Calibration() const {
    return line_task::LineCalibration::Load(path / "calibration.dfr");
  }

  const std::filesystem::path path =
      std::filesystem::temp_directory_path() / ("wire_test_" + std::to_string(getpid()));
};

const Folder& Data() {
  static const Folder folder;
  return folder;
}

RobotConfig LockStep(int domain) {
  RobotConfig config;
  config.robot = RobotPlace::kDds;
  config.network.domain = domain;
  config.simulator = true;
  config.lock_step = true;
  config.emergency_stop = false;
  return config;
}

// Says yes to whatever is asked, but not for ever: what asks again and again gets nowhere.
std::function<bool(std::string_view, std::string_view)> Agrees() {
  return [left = 10](std::string_view, std::string_view) mutable { return left-- > 0; };
}

struct Result {
  core::Outcome outcome;
  control::HaltCause cause;
  bool operator==(const Result&) const = default;
};

Result Episode(core::Plant& plant, control::Controller& controller, std::uint64_t seed) {
  const control::RolloutResult result = control::Rollout(
      plant, controller, {.plant_seed = core::DeriveSeed(seed, {0}), .controller_seed = seed});
  return {result.outcome, result.halt_cause};
}

TEST(WireTest, InLockStepTheSameSeedsHaveTheSameOutcomesAsInOneProcess) {
  const int domain = test::OwnDomain();
  const line_task::LineCalibration known = Data().Calibration();
  const test::PeerProcess simulator({DFR_SIMULATOR, "--lock-step", "--domain",
                                     std::to_string(domain), "--wave", "random", "--calibration",
                                     (Data().path / "calibration.dfr").string()});
  sim::LineTrackingPlant here(Disturbed(), &known);
  RobotPlant there(LockStep(domain), known, nullptr);
  there.BringUp({});
  const LineModel model = LineModel::Load(Data().path / "model");
  int ends = 0;  // bit by outcome
  for (const char* method : {"baseline", "early-stopping", "guided"}) {
    const std::unique_ptr<control::Controller> controller = model.MakeController(method);
    for (std::uint64_t seed = 0; seed < 2; ++seed) {
      SCOPED_TRACE(std::string(method) + ", seed " + std::to_string(seed));
      const Result in_process = Episode(here, *controller, seed);
      const Result over_the_wire = Episode(there, *controller, seed);
      EXPECT_EQ(over_the_wire, in_process)
          << "here " << core::Name(in_process.outcome) << ", there "
          << core::Name(over_the_wire.outcome) << ' ' << control::Name(over_the_wire.cause);
      ends |= 1 << static_cast<int>(in_process.outcome);
    }
  }
  EXPECT_EQ(ends, 7) << "not all kinds of outcomes were compared";
}

TEST(WireTest, AStateMachineThatHoldsStandsStillUntilStarted) {
  const int domain = test::OwnDomain();
  const line_task::LineCalibration known = Data().Calibration();
  std::optional<test::PeerProcess> simulator;
  simulator.emplace(
      std::vector<std::string>{DFR_SIMULATOR, "--lock-step", "--domain", std::to_string(domain)});
  RobotPlant robot(LockStep(domain), known, nullptr);
  robot.BringUp({});
  robot.Reset(1);
  EXPECT_EQ(robot.loop().state(), runtime::RunState::kRunning);
  ASSERT_EQ(robot.Apply(std::array{0.3, 0.0}), core::PlantStatus::kOk) << robot.loop().cause();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(robot.Apply(std::array{nan, 0.0}), core::PlantStatus::kRefused);
  EXPECT_EQ(robot.loop().state(), runtime::RunState::kHolding);
  EXPECT_EQ(robot.Apply(std::array{0.3, 0.0}), core::PlantStatus::kFault) << "it was not started";
  ASSERT_EQ(robot.loop().Start(), runtime::HoldReason::kNone);
  EXPECT_EQ(robot.Apply(std::array{0.3, 0.0}), core::PlantStatus::kOk);

  simulator->Signal(SIGKILL);
  EXPECT_EQ(robot.Apply(std::array{0.3, 0.0}), core::PlantStatus::kFault);
  EXPECT_EQ(robot.loop().state(), runtime::RunState::kFaulted);
  EXPECT_NE(robot.loop().cause().find("arm-silent"), std::string::npos) << robot.loop().cause();
  EXPECT_NE(robot.loop().Start(), runtime::HoldReason::kNone);
}

TEST(WireTest, AnEmergencyStopThatComesLateIsWaitedFor) {
  const int domain = test::OwnDomain();
  const test::PeerProcess simulator(
      {DFR_SIMULATOR, "--lock-step", "--domain", std::to_string(domain)});
  RobotConfig config = LockStep(domain);
  config.emergency_stop = true;
  config.emergency_stop_silence_s = 10.0;
  RobotPlant robot(config, Data().Calibration(), nullptr);
  std::atomic<bool> end = false;
  std::thread operators([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(1500));
    dds::Participant network({.domain = domain});
    dds::EmergencyStopButton button(network);
    for (; !end; std::this_thread::sleep_for(std::chrono::milliseconds(20))) button.Beat();
  });
  std::string said;
  EXPECT_NO_THROW(robot.BringUp([&](std::string_view words) { said = words; }));
  EXPECT_NE(said.find("emergency-stop-silent"), std::string::npos) << said;
  EXPECT_EQ(robot.loop().Start(), runtime::HoldReason::kNone) << robot.loop().blocking_words();
  end = true;
  operators.join();
}

// As where the simulator was stopped: both ways of asking give up by themselves, and the loop has
// gone on meanwhile.
TEST(SimulatorLinkTest, AQuestionThatIsNeverAnsweredEndsAfterFiveSeconds) {
  dds::Participant network({.domain = test::OwnDomain()});
  SimulatorLink link(network);
  SimulatorTruth truth;
  int periods = 0;
  const auto go_on = [&periods] {
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
    return ++periods != 3;
  };
  EXPECT_FALSE(link.Truth(truth, go_on)) << "nobody is to go on";
  EXPECT_EQ(periods, 3);
  for (const std::function<void()>& ask :
       {std::function<void()>([&] { static_cast<void>(link.Truth(truth, go_on)); }),
        std::function<void()>([&] { static_cast<void>(link.Truth()); })}) {
    const auto start = std::chrono::steady_clock::now();
    try {
      ask();
      ADD_FAILURE() << "somebody answers";
    } catch (const std::runtime_error& e) {
      EXPECT_STREQ(e.what(), "the simulator does not answer 'truth'");
    }
    const std::chrono::duration<double> took = std::chrono::steady_clock::now() - start;
    EXPECT_GE(took.count(), 4.9);
    EXPECT_LT(took.count(), 20.0);
  }
  EXPECT_GT(periods, 50);
}

// -- the platform, whose port is an emulator's ----------------------------------------------------

class PlatformTest : public testing::Test {
 protected:
  [[nodiscard]] RobotConfig Robot() const {
    RobotConfig config = LockStep(domain_);
    config.platform.device = port_.device();
    config.platform.wave = hardware::SprkWaveKind::kSine;
    config.platform.motion.amplitude.translation_m.x() = 0.00254;
    config.platform.motion.frequency_hz[0] = 0.1;
    return config;
  }
  // The letters of the first `count` commands.
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
    EXPECT_THROW(robot.BringUp({}), std::runtime_error) << "nobody asked for it";
    std::string asked;
    const auto refuses = [&](std::string_view question, std::string_view word) {
      asked = std::string(question) + "|" + std::string(word);
      return false;
    };
    EXPECT_THROW(robot.BringUp({}, refuses), std::runtime_error);
    EXPECT_NE(asked.find("moves|platform"), std::string::npos) << asked;
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
  EXPECT_EQ(port_.Await(0).back().Pose().translation_m.x(), 0.0) << "in the wave's middle";
}

TEST_F(PlatformTest, APortThatFailsIsAFaultThatNoWordMends) {
  RobotPlant robot(Robot(), Data().Calibration(), nullptr);
  robot.BringUp({}, Agrees());
  robot.Reset(1);
  ASSERT_EQ(Arrived(3), "hac");
  port_.Unplug();
  EXPECT_EQ(robot.Apply(std::array{0.3, 0.0}), core::PlantStatus::kFault) << "it is still moving";
  EXPECT_EQ(robot.loop().state(), runtime::RunState::kFaulted);
  EXPECT_NE(robot.loop().cause().find("platform: its port failed"), std::string::npos)
      << robot.loop().cause();
  static_cast<void>(robot.Clear());
  EXPECT_THROW(robot.Reset(2), std::runtime_error);
  EXPECT_FALSE(robot.loop().may_move());
}

// In real time, on a machine that others use, too: pictures are drawn by its processor.
RobotConfig RealTime(int domain) {
  RobotConfig config = LockStep(domain);
  config.lock_step = false;
  config.image_max_age_s = 5.0;
  config.max_period_s = 5.0;
  config.arm_client.watchdog.max_age_s = config.arm_client.watchdog.max_silence_s = 5.0;
  config.arm_client.max_tick_gap_s = 5.0;
  return config;
}

TEST(WireTest, TheLoopAllocatesNothingInRealTime) {
  const int domain = test::OwnDomain();
  const line_task::LineCalibration known = Data().Calibration();
  const test::PeerProcess simulator({DFR_SIMULATOR, "--domain", std::to_string(domain), "--homing",
                                     "0.1", "--image-period", "0.1"});
  RobotPlant robot(RealTime(domain), known, nullptr);
  robot.BringUp({});
  robot.Reset(1);
  ASSERT_EQ(robot.loop().state(), runtime::RunState::kRunning) << robot.loop().cause();
  {
    const test::NoAlloc no_alloc;
    robot.loop().Idle(0.5);
  }
  EXPECT_EQ(robot.loop().state(), runtime::RunState::kRunning) << robot.loop().cause();
}

TEST(WireTest, AnEpisodeBeginsAsSoonAsWhatWasWrongBeforeIsOver) {
  const int domain = test::OwnDomain();
  const test::PeerProcess simulator({DFR_SIMULATOR, "--domain", std::to_string(domain), "--homing",
                                     "0.1", "--image-period", "0.1"});
  RobotPlant robot(RealTime(domain), Data().Calibration(), nullptr);
  robot.BringUp({});
  dds::Participant network({.domain = domain});
  SimulatorLink link(network);
  link.Await(10.0);
  link.Fault("invalid", "1");
  std::thread repair([&] {
    std::this_thread::sleep_for(std::chrono::seconds(1));
    link.Fault("invalid", "0");
  });
  EXPECT_NO_THROW(robot.Reset(1));
  repair.join();
  EXPECT_EQ(robot.loop().state(), runtime::RunState::kRunning) << robot.loop().cause();
  link.Fault("invalid", "1");
  EXPECT_THROW(robot.Reset(2), std::runtime_error) << "it lasts";
  EXPECT_FALSE(robot.loop().blocking_words().empty());
}

// -- bringing up a robot, whose console is the simulator's ----------------------------------------

class BringUpTest : public testing::Test {
 protected:
  [[nodiscard]] RobotConfig Robot() const {
    RobotConfig config = RealTime(domain_);
    config.simulator = false;
    config.emergency_stop = true;
    config.emergency_stop_silence_s = 0.5;
    return config;
  }
  // Beats as long as this lives.
  struct Operator {
    explicit Operator(int domain) : network({.domain = domain}) {
      thread = std::thread([this] {
        for (; !end; std::this_thread::sleep_for(std::chrono::milliseconds(20))) {
          if (press && !button.pressed()) button.Press();
          if (!silent) button.Beat();
        }
      });
    }
    ~Operator() {
      end = true;
      thread.join();
    }
    Operator(const Operator&) = delete;
    Operator& operator=(const Operator&) = delete;

    dds::Participant network;
    dds::EmergencyStopButton button{network};
    std::atomic<bool> press = false;
    std::atomic<bool> silent = false;
    std::atomic<bool> end = false;
    std::thread thread;
  };
  // What the console says of its arm, since the last call.
  [[nodiscard]] bool ConsoleSaid(std::string_view state, bool busy, double seconds) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(seconds);
    dds::OperatingState heard;
    while (std::chrono::steady_clock::now() < end) {
      while (arm_.Take(heard)) {
        if (heard.state == state && heard.is_busy == busy) return true;
      }
      static_cast<void>(arm_.Wait(0.01));
    }
    return false;
  }

  int domain_ = test::OwnDomain();
  test::PeerProcess simulator_{std::vector<std::string>{
      DFR_SIMULATOR, "--domain", std::to_string(domain_), "--homing", "1.5"}};
  dds::Participant network_{{.domain = domain_}};
  dds::Subscriber<dds::OperatingState> arm_{network_, "/PSM1/operating_state", dds::Role::kEvent};
};

TEST_F(BringUpTest, NothingIsPoweredUpUnlessTheOperatorAsks) {
  const Operator person(domain_);
  RobotPlant robot(Robot(), Data().Calibration(), nullptr);
  EXPECT_THROW(robot.BringUp({}), std::runtime_error);
  std::string asked;
  const auto refuses = [&](std::string_view question, std::string_view word) {
    asked = std::string(question) + "|" + std::string(word);
    return false;
  };
  EXPECT_THROW(robot.BringUp({}, refuses), std::runtime_error);
  EXPECT_NE(asked.find("moves|home"), std::string::npos) << asked;
  EXPECT_FALSE(ConsoleSaid("ENABLED", true, 0.2));
  EXPECT_NO_THROW(robot.BringUp({}, Agrees()));
  EXPECT_TRUE(ConsoleSaid("ENABLED", false, 5.0));
}

TEST_F(BringUpTest, AStopThatIsPressedInTheMiddleOfHomingEndsIt) {
  Operator person(domain_);
  RobotPlant robot(Robot(), Data().Calibration(), nullptr);
  std::thread presses([&] {
    EXPECT_TRUE(ConsoleSaid("ENABLED", true, 20.0));
    person.press = true;
  });
  try {
    robot.BringUp({}, Agrees());
    ADD_FAILURE() << "it went on";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("emergency-stop: pressed"), std::string::npos) << e.what();
  }
  presses.join();
  EXPECT_TRUE(ConsoleSaid("DISABLED", false, 1.0));
}

TEST_F(BringUpTest, AStopThatVanishesInTheMiddleOfHomingEndsIt) {
  Operator person(domain_);
  RobotPlant robot(Robot(), Data().Calibration(), nullptr);
  std::thread vanishes([&] {
    EXPECT_TRUE(ConsoleSaid("ENABLED", true, 20.0));
    person.silent = true;
  });
  try {
    robot.BringUp({}, Agrees());
    ADD_FAILURE() << "it went on";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("emergency-stop-silent"), std::string::npos) << e.what();
  }
  vanishes.join();
  EXPECT_TRUE(ConsoleSaid("DISABLED", false, 1.0));
}

TEST_F(BringUpTest, CtrlCEndsHomingAndWaiting) {
  const Operator person(domain_);
  std::atomic<bool> interrupted = false;
  RunOperator run_operator;
  run_operator.interrupted = &interrupted;
  RobotPlant robot(Robot(), Data().Calibration(), nullptr, run_operator);
  std::thread interrupts([&] {
    EXPECT_TRUE(ConsoleSaid("ENABLED", true, 20.0));
    interrupted = true;
  });
  try {
    robot.BringUp({}, Agrees());
    ADD_FAILURE() << "it went on";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("interrupted"), std::string::npos) << e.what();
  }
  interrupts.join();
  EXPECT_TRUE(ConsoleSaid("DISABLED", false, 1.0));
  const auto start = std::chrono::steady_clock::now();
  EXPECT_THROW(robot.BringUp({}, Agrees()), std::runtime_error);
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(2));
}

TEST_F(BringUpTest, AStopThatIsPressedHasToBeReleasedAndCleared) {
  Operator person(domain_);
  person.press = true;
  RobotPlant robot(Robot(), Data().Calibration(), nullptr);
  std::vector<std::string> words;
  const auto answers = [&](std::string_view, std::string_view word) {
    words.emplace_back(word);
    return words.size() < 2;
  };
  EXPECT_THROW(robot.BringUp({}, answers), std::runtime_error);
  EXPECT_EQ(words, (std::vector<std::string>{"clear", "clear"})) << "it is still pressed";
  EXPECT_FALSE(ConsoleSaid("ENABLED", true, 0.2));
}

// The tool hangs askew over the line: it is lifted, looked at, turned and lowered again.
class AskewTest : public BringUpTest {
 protected:
  // Where the simulator says that the tip is, with the arm's tool tilted by 0.3 rad about it.
  void Tilt() {
    dds::Participant network({.domain = domain_});
    SimulatorLink link(network);
    link.Await(10.0);
    link.Reset(1);
    dds::Subscriber<dds::PoseStamped> measured(network, "/PSM1/setpoint_cp", dds::Role::kState);
    dds::Publisher<dds::PoseStamped> move(network, "/PSM1/move_cp", dds::Role::kRequest);
    dds::PoseStamped pose;
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    while (!(measured.TakeNewest(pose) && pose.stamp.valid()) || move.num_subscribers() == 0) {
      ASSERT_LT(std::chrono::steady_clock::now(), end);
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(500));  // until it knows us, too
    const Eigen::Vector3d jaw(0.0, 0.0, kinematics::Psm::kJawLength);
    const Eigen::Vector3d tip = pose.position_m + pose.orientation * jaw;
    pose.orientation =
        pose.orientation * Eigen::Quaterniond(Eigen::AngleAxisd(0.3, Eigen::Vector3d::UnitX()));
    pose.position_m = tip - pose.orientation * jaw;
    ASSERT_TRUE(move.Write(pose));
    for (dds::PoseStamped now; std::chrono::steady_clock::now() < end;
         std::this_thread::sleep_for(std::chrono::milliseconds(10))) {
      if (measured.TakeNewest(now) && (now.position_m - pose.position_m).norm() < 1e-6) break;
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(500));  // the joints follow
  }
};

TEST_F(AskewTest, TheToolIsLiftedThenTurnedAndNeverGoesDown) {
  Tilt();
  const Operator person(domain_);
  RobotPlant robot(Robot(), Data().Calibration(), nullptr);
  robot.BringUp({}, Agrees());
  SimulatorLink link(network_);
  link.Await(10.0);
  const double before = link.Truth().tip_m.z();
  std::atomic<bool> done = false;
  double lowest = before;
  double highest = before;
  std::thread watches([&] {
    while (!done) {
      const double z = link.Truth().tip_m.z();
      lowest = std::min(lowest, z);
      highest = std::max(highest, z);
    }
  });
  EXPECT_NO_THROW(robot.Reset(1));
  done = true;
  watches.join();
  EXPECT_EQ(robot.loop().state(), runtime::RunState::kRunning) << robot.loop().cause();
  // What the encoders have, within 0.3 mm; the simulated cables add a few tenths.
  EXPECT_GT(lowest, before - 1e-3);
  EXPECT_GT(highest, before + 4e-3);
}

TEST_F(AskewTest, NothingMovesWhereAWayWouldLeaveTheRegion) {
  Tilt();
  const Operator person(domain_);
  RobotConfig config = Robot();
  config.region.box_min_m.z() = 0.02;  // so high that the tip is already below, and would return
  RobotPlant robot(config, Data().Calibration(), nullptr);
  robot.BringUp({}, Agrees());
  SimulatorLink link(network_);
  link.Await(10.0);
  const Eigen::Vector3d before = link.Truth().tip_m;
  try {
    robot.Reset(1);
    ADD_FAILURE() << "it went on";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("mm beyond the floor; move it by hand"), std::string::npos)
        << e.what();
  }
  EXPECT_LT((link.Truth().tip_m - before).norm(), 1e-4);
}

TEST(EmergencyStopMonitorTest, SaysHowTheLoopStandsAndThatItEnds) {
  dds::Participant network({.domain = test::OwnDomain()});
  dds::Subscriber<dds::OperatingState> listener(network, dds::kRunStateTopic, dds::Role::kState);
  std::optional<EmergencyStopMonitor> monitor;
  monitor.emplace(network, false, 1.0);
  dds::OperatingState heard;
  for (int i = 0; i < 500 && heard.state != "holding"; ++i) {
    monitor->Beat(runtime::RunState::kHolding);
    if (listener.Wait(0.01)) static_cast<void>(listener.TakeNewest(heard));
  }
  EXPECT_EQ(heard.state, "holding");
  monitor.reset();
  while (listener.Wait(1.0) && heard.state != dds::kRunEnded) {
    static_cast<void>(listener.TakeNewest(heard));
  }
  EXPECT_EQ(heard.state, dds::kRunEnded);
}

TEST(LaunchTest, AllItStartsIsOfTheRunsSecuredNetwork) {
  const test::Keystore keys = {{"line_tracking", dds::Permission::kController},
                               {"dvrk_simulator", dds::Permission::kConsole},
                               {"stop", dds::Permission::kButton}};
  const std::filesystem::path config = Data().path / "secured.toml";
  const std::filesystem::path recordings = Data().path / "secured";
  std::ofstream(config) << "robot = 'dds'\nmodel = '" << (Data().path / "model").string()
                        << "'\ncalibration = '" << (Data().path / "calibration.dfr").string()
                        << "'\nrecordings = '" << recordings.string()
                        << "'\n[network]\ndomain = " << test::OwnDomain() << "\nsecurity = '"
                        << keys.enclave("line_tracking").string()
                        << "'\n[simulator]\npresent = true\nlock_step = true\n"
                           "[emergency_stop]\nmax_silence_s = 10.0\n";
  test::PeerProcess launch(
      {DFR_LINE_TRACKING, "launch", "--config", config.string(), "--episodes", "1"});
  ASSERT_EQ(launch.Await(120.0), 0);
  ASSERT_TRUE(std::filesystem::exists(recordings));
  const recording::Recording log =
      recording::ReadRecording(std::filesystem::directory_iterator(recordings)->path());
  EXPECT_GT(log.steps.size(), 0U);
}

TEST(LaunchTest, WhatWasSimulatedDrivesNoRobot) {
  const LineModel model = LineModel::Load(Data().path / "model");
  EXPECT_EQ(model.demonstrations().provenance.origin, core::Origin::kSimulated);
  EXPECT_EQ(Data().Calibration().provenance.origin, core::Origin::kSimulated);
  RunOptions options;
  options.config = Data().path / "robot.toml";
  std::ofstream(options.config) << "robot = 'dds'\nmodel = '" << (Data().path / "model").string()
                                << "'\n[arm]\nserial = 'A7'\n[camera]\nname = 'left eye'\n";
  try {
    RunRun(options);
    ADD_FAILURE() << "it was taken";
  } catch (const std::runtime_error& e) {
    const std::string words = e.what();
    EXPECT_NE(words.find("model: its origin is 'simulated'"), std::string::npos) << words;
    EXPECT_NE(words.find("fit again"), std::string::npos) << words;
  }
}

TEST(RecordedControllerTest, ARecordingIsDecidedAgainToTheBitAndADifferenceIsSeen) {
  const std::filesystem::path path = Data().path / "run.mcap";
  const std::filesystem::path folder = Data().path / "model";
  const LineModel model = LineModel::Load(folder);
  recording::RecordingMetadata metadata;
  metadata.model = folder.string();
  metadata.model_checksum = recording::Checksum(folder);
  metadata.method = "guided";
  metadata.commit = "0123456789ab";
  const line_task::LineCalibration known = Data().Calibration();
  sim::LineTrackingPlant plant(FromTruth(), &known);
  {
    recording::Recorder recorder(path, metadata);
    const std::unique_ptr<control::Controller> guided = model.MakeController("guided");
    RecordedController controller(*guided, &recorder);
    for (std::uint64_t episode = 0; episode < 3; ++episode) {
      controller.BeginEpisode(episode);
      static_cast<void>(Episode(plant, controller, episode));
    }
    recorder.Finish();
  }
  const recording::Recording log = recording::ReadRecording(path);
  EXPECT_GT(log.steps.size(), 60U);
  EXPECT_EQ(log.steps.front().state.view().size(), 4U);
  testing::internal::CaptureStdout();
  EXPECT_TRUE(ReplayRecording(path, {}));
  // Where methods have changed since, it says why decisions may differ.
  EXPECT_NE(testing::internal::GetCapturedStdout().find("this program is of commit "),
            std::string::npos);

  // Another model decides otherwise.
  LineModelOptions other;
  other.hidden = {8};
  other.gammas = {0.5};
  const std::filesystem::path elsewhere = Data().path / "other";
  LineModel::Fit(Demonstrate(FromTruth(), known, 12, 50, 9), other).Save(elsewhere);
  EXPECT_FALSE(ReplayRecording(path, elsewhere));
}

// "All decisions are the same" would be true of it.
TEST(RecordedControllerTest, ARecordingWithoutDecisionsIsNotMadeAgain) {
  const std::filesystem::path path = Data().path / "empty.mcap";
  recording::RecordingMetadata metadata;
  metadata.model = (Data().path / "model").string();
  metadata.model_checksum = recording::Checksum(Data().path / "model");
  metadata.method = "guided";
  recording::Recorder(path, metadata).Finish();
  try {
    static_cast<void>(ReplayRecording(path, {}));
    ADD_FAILURE() << "nothing was made again";
  } catch (const std::runtime_error& e) {
    EXPECT_NE(std::string(e.what()).find("empty.mcap holds no decision"), std::string::npos)
        << e.what();
  }
}

}  // namespace
}  // namespace dfr::apps::line_tracking
