// Line tracking on the simulated console in real time, and the effect of killing one of its
// processes.
//
// An idle machine finds all devices and brings up the robot in an estimated 2.5 s.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "robot/robot_plant.h"
#include "simulator/simulator_link.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/line_tracking/lock_step_config.h"
#include "tests/line_tracking/model_folder.h"
#include "tests/support/message_of.h"
#include "tests/support/no_alloc.h"

namespace dfr::apps::line_tracking {
namespace {

constexpr double kPatience = 25.0;  // s, ten times the estimate

class RealTimeTest : public testing::Test {
 protected:
  // Returns a configuration with limits for a busy machine, whose processor draws the pictures.
  [[nodiscard]] RobotConfig Simulated() const {
    RobotConfig config = LockStepConfig(domain_);
    config.lock_step = false;
    config.simulator_answer_s = 5.0;
    config.image_max_age_s = 5.0;
    config.max_period_s = 5.0;
    config.arm_client.watchdog.max_age_s = config.arm_client.watchdog.max_silence_s = 5.0;
    config.arm_client.max_tick_gap_s = 5.0;
    return config;
  }
  // Same as Simulated(), but treats the console as a robot's.
  [[nodiscard]] RobotConfig Robot() const {
    RobotConfig config = Simulated();
    config.simulator = false;
    config.emergency_stop = true;
    config.emergency_stop_silence_s = 0.5;
    return config;
  }
  [[nodiscard]] std::vector<std::string> Stop() const {
    return {DFR_HARDWARE, "stop", "--unattended", "--domain", std::to_string(domain_)};
  }
  // Returns true if the console reports this state of its arm.
  [[nodiscard]] bool ConsoleSays(std::string_view state, bool busy) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(kPatience);
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
  test::PeerProcess simulator_{std::vector<std::string>{DFR_SIMULATOR, "--domain",
                                                        std::to_string(domain_), "--homing", "1.5",
                                                        "--image-period", "0.1"}};
  dds::Participant network_{{.domain = domain_}};
  dds::Subscriber<dds::OperatingState> arm_{network_, "/PSM1/operating_state", dds::Role::kEvent};
};

TEST_F(RealTimeTest, TheLoopAllocatesNothingAndHoldsWhenTheConsoleIsKilled) {
  RobotPlant robot(Simulated(), Data().Calibration(), nullptr);
  robot.BringUp({});
  robot.Reset(1);
  ASSERT_EQ(robot.loop().state(), runtime::RunState::kRunning) << robot.loop().cause();
  {
    const test::NoAlloc no_alloc;
    robot.loop().Idle(0.5);
  }
  EXPECT_EQ(robot.loop().state(), runtime::RunState::kRunning) << robot.loop().cause();
  simulator_.Signal(SIGKILL);
  for (int n = 0; n < 250 && robot.loop().may_move(); ++n) robot.loop().Idle(kPatience / 250);
  EXPECT_EQ(robot.loop().state(), runtime::RunState::kFaulted);
  EXPECT_NE(robot.loop().Start(), runtime::HoldReason::kNone);
}

TEST_F(RealTimeTest, AStopThatIsKilledInTheMiddleOfHomingEndsIt) {
  const test::PeerProcess stop(Stop());
  RobotPlant robot(Robot(), Data().Calibration(), nullptr);
  std::thread kills([&] {
    EXPECT_TRUE(ConsoleSays("ENABLED", true));
    stop.Signal(SIGKILL);
  });
  EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { robot.BringUp({}, Agrees()); }),
              testing::HasSubstr("emergency-stop-silent"));
  kills.join();
  EXPECT_TRUE(ConsoleSays("DISABLED", false));
}

TEST_F(RealTimeTest, TheArmStandsStillWhenItsProgramIsKilled) {
  const std::filesystem::path config = Data().path / "killed.toml";
  std::ofstream(config) << "robot = 'dds'\nmodel = '" << (Data().path / "model").string()
                        << "'\ncalibration = '" << (Data().path / "calibration.dfr").string()
                        << "'\nrecordings = 'none'\n[network]\ndomain = " << domain_
                        << "\n[arm]\nmax_age_s = 5.0\nmax_silence_s = 5.0\n[camera]\nmax_age_s = "
                           "5.0\n[simulator]\npresent = true\n[emergency_stop]\nrequired = "
                           "false\n[loop]\npriority = 0\nmax_period_s = 5.0\n";
  const test::PeerProcess program(
      {DFR_LINE_TRACKING, "run", "--config", config.string(), "--episodes", "100"});
  dds::Subscriber<dds::PoseStamped> setpoint(network_, "/PSM1/setpoint_cp", dds::Role::kState);
  dds::PoseStamped first;
  dds::PoseStamped pose;
  const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(2 * kPatience);
  const auto moved = [&] { return (pose.position_m - first.position_m).norm(); };
  // Waits for the middle of an episode: the arm has moved by more than a millimetre since its first
  // set-point.
  bool began = false;
  while (!(began && moved() > 0.001) && std::chrono::steady_clock::now() < end) {
    if (!setpoint.Wait(0.1) || !setpoint.TakeNewest(pose) || !pose.stamp.valid()) continue;
    if (!began || moved() > 0.005) first = pose;  // the arm was placed elsewhere
    began = true;
  }
  ASSERT_GT(moved(), 0.001) << "the arm does not move";
  program.Signal(SIGKILL);
  std::this_thread::sleep_for(std::chrono::milliseconds(500));  // five times the console's lag
  ASSERT_TRUE(setpoint.TakeNewest(first));
  std::this_thread::sleep_for(std::chrono::milliseconds(500));
  ASSERT_TRUE(setpoint.TakeNewest(pose));
  EXPECT_EQ(moved(), 0.0);
}

// The reason that the arm is not ready must not hide that its joints are unknown.
TEST_F(RealTimeTest, AnArmWhoseJointsAreUnknownGivesNoFrameOfACalibration) {
  RobotPlant robot(Simulated(), Data().Calibration(), nullptr);
  robot.BringUp({});
  SimulatorLink link(network_);
  link.Await(kPatience);
  link.Reset(1);
  dds::Publisher<dds::StringStamped> command(network_, "/PSM1/state_command", dds::Role::kRequest);
  dds::StringStamped disable;
  disable.text = "disable";
  const auto says = [&](std::string_view words) {
    for (int n = 0; n < 250; ++n) {
      if (robot.loop().blocking_words().find(words) != std::string::npos) return true;
      disable.stamp = dds::Stamp::Now();
      EXPECT_TRUE(command.Write(disable));
      robot.loop().Idle(kPatience / 250);
    }
    return false;
  };
  const auto refusal = [&] {
    return test::MessageOf<std::runtime_error>([&] { (void)robot.CaptureCalibrationFrame(); });
  };
  ASSERT_TRUE(says("DISABLED")) << robot.loop().blocking_words();
  EXPECT_NO_THROW((void)robot.CaptureCalibrationFrame());
  link.Fault("invalid", "1");
  robot.loop().Idle(0.5);
  ASSERT_TRUE(says("DISABLED")) << robot.loop().blocking_words();
  EXPECT_THAT(refusal(), testing::HasSubstr("are marked invalid"));
  link.Fault("invalid", "0");
  robot.loop().Idle(0.5);
  const dds::Publisher<dds::JointState> second(network_, "/PSM1/measured_js", dds::Role::kState);
  ASSERT_TRUE(says("more than one program")) << robot.loop().blocking_words();
  EXPECT_THAT(refusal(), testing::HasSubstr("more than one program publishes the arm's state"));
}

// The participant can hold, free and disable the arm, and joined before the run. Runs eight
// whole episodes in real time. Only this test finds a false alarm that depends on the timing of a
// run.
TEST_F(RealTimeTest, InSeveralEpisodesAnEarlierParticipantIsNoReasonToHold) {
  dds::Participant window({.domain = domain_, .name = "window"});
  const dds::Publisher<dds::Signal> hold(window, "/PSM1/hold", dds::Role::kRequest);
  const dds::Publisher<dds::Signal> free(window, "/PSM1/free", dds::Role::kRequest);
  const dds::Publisher<dds::StringStamped> command(window, "/PSM1/state_command",
                                                   dds::Role::kRequest);
  const dds::Subscriber<dds::PoseStamped> shows(window, "/PSM1/measured_cp", dds::Role::kState);
  RobotPlant robot(Simulated(), Data().Calibration(), nullptr);
  std::string said;
  robot.BringUp([&said](std::string_view text) { said += std::string(text) + '\n'; });
  for (const char* topic : {"/PSM1/hold", "/PSM1/free", "/PSM1/state_command"}) {
    EXPECT_NE(said.find(topic), std::string::npos) << said;
  }
  const LineModel model = LineModel::Load(Data().path / "model");
  const std::unique_ptr<control::Controller> controller = model.MakeController("baseline");
  int completed = 0;
  int controls = 0;
  for (std::uint64_t episode = 0; episode < 8; ++episode) {
    SCOPED_TRACE(episode);
    const control::RolloutResult result =
        control::Rollout(robot, *controller, {.plant_seed = episode, .controller_seed = episode});
    completed += result.outcome == core::Outcome::kCompleted ? 1 : 0;
    controls += result.controls();
    ASSERT_TRUE(robot.loop().ended_regularly()) << robot.loop().cause();
  }
  EXPECT_GT(controls, 8 * 10) << "the arm barely moves";
  std::printf("%d of 8 episodes completed, %d controls\n", completed, controls);
}

// The tool is tilted over the line: the program lifts it, observes the gauze, and turns and lowers
// it.
class AskewTest : public RealTimeTest {
 protected:
  // Moves the simulator's arm to a tilt of 0.3 rad about the tip.
  void Tilt() {
    dds::Participant network({.domain = domain_});
    SimulatorLink link(network);
    link.Await(kPatience);
    link.Reset(1);
    dds::Subscriber<dds::PoseStamped> measured(network, "/PSM1/setpoint_cp", dds::Role::kState);
    dds::Publisher<dds::PoseStamped> move(network, "/PSM1/move_cp", dds::Role::kRequest);
    dds::PoseStamped pose;
    const auto end = std::chrono::steady_clock::now() + std::chrono::duration<double>(kPatience);
    while (!(measured.TakeNewest(pose) && pose.stamp.valid()) || move.num_subscribers() == 0) {
      ASSERT_LT(std::chrono::steady_clock::now(), end);
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
    std::this_thread::sleep_for(
        std::chrono::milliseconds(500));  // until the console has discovered this participant
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
  const test::PeerProcess stop(Stop());
  RobotPlant robot(Robot(), Data().Calibration(), nullptr);
  robot.BringUp({}, Agrees());
  SimulatorLink link(network_);
  link.Await(kPatience);
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
  // The encoders allow a deviation of 0.3 mm, and the simulated cables add a few tenths.
  EXPECT_GT(lowest, before - 1e-3);
  EXPECT_GT(highest, before + 4e-3);
}

TEST_F(AskewTest, RefusesAPathThatLeavesTheRegion) {
  Tilt();
  const test::PeerProcess stop(Stop());
  RobotConfig config = Robot();
  // The tip starts below this floor and would have to return below it.
  config.region.box_min_m.z() = 0.02;
  RobotPlant robot(config, Data().Calibration(), nullptr);
  robot.BringUp({}, Agrees());
  SimulatorLink link(network_);
  link.Await(kPatience);
  const Eigen::Vector3d before = link.Truth().tip_m;
  EXPECT_THAT(test::MessageOf<std::runtime_error>([&] { robot.Reset(1); }),
              testing::HasSubstr("mm beyond the floor; move it by hand"));
  EXPECT_LT((link.Truth().tip_m - before).norm(), 1e-4);
}

}  // namespace
}  // namespace dfr::apps::line_tracking
