// A robot from nothing, over the network: calibrate, demonstrate, fit and run in sequence, as an
// operator does, on dvrk_simulator's console, which the programs treat as a robot's console.
//
// An idle machine takes an estimated 2 s until a program asks its first question, 0.5 s until a
// picture is taken or the simulator answers, and 6 s for an episode. The test took 60 s on two
// cores with ten other processes.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <optional>
#include <sstream>
#include <string>
#include <string_view>
#include <thread>
#include <vector>

#include "commands/commands.h"
#include "dfr/core/random.h"
#include "dfr/hardware/intrinsics_file.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/sim/line_tracking/calibration_motion.h"
#include "simulator/simulator_link.h"
#include "tests/dds/domain.h"
#include "tests/dds/peer_process.h"
#include "tests/line_tracking/scene.h"
#include "tests/support/temp_folder.h"
#include "tests/support/write_intrinsics.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

constexpr double kQuestion = 20.0;  // s, ten times the estimate
constexpr double kEpisode = 60.0;   // s, ten times the estimate
constexpr double kAnswer = 10.0;    // s, twenty times the estimate

// The program with an operator at its keyboard.
class Program {
 public:
  Program(const std::filesystem::path& folder, const std::string& arguments)
      : shown_(folder / "shown.txt"), typed_(folder / "typed") {
    std::filesystem::remove(shown_);  // removes the output of the previous program
    std::filesystem::remove(typed_);
    EXPECT_EQ(::mkfifo(typed_.c_str(), 0600), 0);
    keyboard_ = ::open(typed_.c_str(), O_RDWR);
    process_.emplace(std::vector<std::string>{"/bin/sh", "-c",
                                              std::string("exec ") + DFR_LINE_TRACKING + " " +
                                                  arguments + " < " + typed_.string() + " > " +
                                                  shown_.string() + " 2>&1"});
  }
  ~Program() { ::close(keyboard_); }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  void Type(std::string_view text) const {
    EXPECT_EQ(::write(keyboard_, text.data(), text.size()), static_cast<ssize_t>(text.size()));
  }
  [[nodiscard]] std::string Shown() const { return test::FileText(shown_); }

  // Waits for one of the texts in the output after the previous match. Returns the index of the
  // first text, or -1.
  int Await(const std::vector<std::string>& texts, double seconds = kQuestion) {
    const auto end = steady_clock::now() + std::chrono::duration<double>(seconds);
    while (steady_clock::now() < end) {
      const std::string shown = Shown();
      for (std::size_t i = 0; i < texts.size(); ++i) {
        const std::size_t at = shown.find(texts[i], heard_);
        if (at == std::string::npos) continue;
        heard_ = at + texts[i].size();
        return static_cast<int>(i);
      }
      std::this_thread::sleep_for(milliseconds(5));
    }
    return -1;
  }
  // Answers questions until an episode begins: on a busy machine the robot may hold for a moment,
  // and the operator starts it again. `place` puts the tip over the beginning of a line.
  [[nodiscard]] bool Begin(const std::function<void()>& place) {
    for (int n = 0; n < 5; ++n) {
      const int asked = Await({"Enter starts", "type start", "type clear"});
      if (asked < 0) return false;
      if (asked == 2) {
        Type("clear\n");
        continue;
      }
      place();
      Type(asked == 0 ? "\n" : "start\n");
      return true;
    }
    return false;
  }
  [[nodiscard]] int End() { return process_->Await(); }

 private:
  std::filesystem::path shown_;
  std::filesystem::path typed_;
  int keyboard_ = -1;
  std::size_t heard_ = 0;
  std::optional<test::PeerProcess> process_;
};

// Moves the arm as a teleoperation at the console does.
class Surgeon {
 public:
  explicit Surgeon(int domain) : network_({.domain = domain}), link_(network_) {
    link_.Await(kAnswer);
    const auto end = steady_clock::now() + std::chrono::duration<double>(kQuestion);
    while (!(setpoint_.TakeNewest(pose_) && pose_.stamp.valid()) || servo_.num_subscribers() == 0) {
      if (steady_clock::now() > end) throw std::runtime_error("there is no console");
      std::this_thread::sleep_for(milliseconds(10));
    }
    // Waits until the console has discovered this participant.
    std::this_thread::sleep_for(milliseconds(300));
    at_ = Tip();
  }
  [[nodiscard]] SimulatorLink& link() { return link_; }
  // Position of the tip in the world frame, without cable errors.
  [[nodiscard]] const Eigen::Vector3d& at() const { return at_; }
  // Moves straight to the target and rests there.
  void Lead(const Eigen::Vector3d& goal, double speed_m_s) {
    const Eigen::Vector3d from = at_;
    const int steps = std::max(1, static_cast<int>((goal - from).norm() / speed_m_s / 0.01));
    for (int i = 1; i <= steps; ++i) {
      at_ = from + (goal - from) * i / steps;
      dds::PoseStamped pose = pose_;
      pose.position_m = sim::LineTrackingPlant::p_world_base().inverse() * at_ - Jaw();
      ASSERT_TRUE(servo_.Write(pose));
      std::this_thread::sleep_for(milliseconds(10));
    }
  }

 private:
  [[nodiscard]] Eigen::Vector3d Jaw() const {
    return pose_.orientation * Eigen::Vector3d(0.0, 0.0, kinematics::Psm::kJawLength);
  }
  [[nodiscard]] Eigen::Vector3d Tip() const {
    return sim::LineTrackingPlant::p_world_base() * Eigen::Vector3d(pose_.position_m + Jaw());
  }

  dds::Participant network_;
  SimulatorLink link_;
  dds::Subscriber<dds::PoseStamped> setpoint_{network_, "/PSM1/setpoint_cp", dds::Role::kState};
  dds::Publisher<dds::PoseStamped> servo_{network_, "/PSM1/servo_cp", dds::Role::kRequest};
  dds::PoseStamped pose_;
  Eigen::Vector3d at_;
};

class RobotFromNothingSystemTest : public testing::Test {
 protected:
  RobotFromNothingSystemTest() {
    test::WriteIntrinsics(folder_ / "camera.yaml", sim::LineTrackingPlant::true_camera());
    // Sets limits for a busy machine.
    std::ofstream(config_) << "robot = 'dds'\nmodel = '" << (folder_ / "model").string()
                           << "'\ncalibration = '" << (folder_ / "calibration.dfr").string()
                           << "'\nmethod = 'baseline'\nrecordings = 'none'\n[network]\ndomain = "
                           << domain_
                           << "\n[arm]\nserial = 'A7'\nspeed = 0.03\nmax_age_s = 5.0\n"
                              "max_silence_s = 5.0\n[camera]\nname = 'left eye'\nintrinsics = '"
                           << (folder_ / "camera.yaml").string()
                           << "'\nmax_age_s = 5.0\n[emergency_stop]\nmax_silence_s = 5.0\n"
                              "[loop]\npriority = 0\nmax_period_s = 5.0\n";
  }
  [[nodiscard]] std::vector<std::string> Console() const {
    return {DFR_SIMULATOR, "--domain", std::to_string(domain_), "--homing", "0.2"};
  }
  // Takes twenty pictures; in twelve of them the tip touches the gauze.
  void Calibrate() {
    const test::PeerProcess console(Console());
    Program program(folder_.path, "calibrate --config " + config_.string());
    ASSERT_EQ(program.Await({"type home"}), 0) << program.Shown();
    program.Type("home\n");
    ASSERT_EQ(program.Await({"0 pictures; the tip touches the gauze in 0."}), 0) << program.Shown();
    program.Type("done\n");
    ASSERT_EQ(program.Await({"has to touch the gauze in 10 pictures"}), 0) << program.Shown();
    Surgeon surgeon(domain_);
    core::Random random(1);
    double lower_m = 0.0;  // distance of the true tip above the arm's estimate
    int taken = 0;
    for (int i = 0; i < 40 && taken < 20; ++i) {
      const bool touches = taken % 5 > 1;
      Eigen::Vector3d goal(random.Uniform(-0.025, 0.025), random.Uniform(-0.015, 0.015),
                           touches ? -lower_m : random.Uniform(0.004, 0.025));
      surgeon.Lead(goal, 0.2);
      for (int n = 0; n < 2 && touches; ++n) {
        std::this_thread::sleep_for(milliseconds(150));
        const double above = surgeon.link().Truth().tip_m.z();
        lower_m += above;
        goal.z() -= above;
        surgeon.Lead(goal, 0.05);
      }
      std::this_thread::sleep_for(milliseconds(200));
      program.Type(touches ? "t\n" : "\n");
      const std::string next = std::to_string(taken + 1) + " pictures; the tip";
      const int answer = program.Await({next, "no picture was taken"});
      ASSERT_GE(answer, 0) << program.Shown();
      if (answer == 0) {
        ++taken;
      } else {
        ASSERT_EQ(program.Await({"done calibrates"}), 0) << program.Shown();
      }
    }
    program.Type("done\n");
    EXPECT_EQ(program.Await({"calibration.dfr written", "not calibrated"}), 0) << program.Shown();
    EXPECT_EQ(program.End(), 0);
  }
  // Moves the tip over the beginning of a line.
  void Place(std::uint64_t seed) const {
    dds::Participant network({.domain = domain_});
    SimulatorLink link(network);
    link.Await(kAnswer);
    link.Reset(seed);
    std::this_thread::sleep_for(milliseconds(600));
  }
  [[nodiscard]] core::Provenance Own() const { return ProvenanceOf(RobotConfig::Load(config_)); }

  const int domain_ = test::OwnDomain();
  const test::TempFolder folder_;
  const std::filesystem::path config_ = folder_ / "robot.toml";
  const test::PeerProcess stop_{
      {DFR_HARDWARE, "stop", "--unattended", "--domain", std::to_string(domain_)}};
};

TEST_F(RobotFromNothingSystemTest, CalibratesDemonstratesFitsAndRuns) {
  Calibrate();
  if (HasFailure()) return;
  const line_task::LineCalibration known =
      line_task::LineCalibration::Load(folder_ / "calibration.dfr");
  EXPECT_EQ(known.provenance, Own());
  EXPECT_EQ(known.camera, sim::LineTrackingPlant::true_camera()) << "the file's intrinsics stay";

  sim::LineTrackingOptions still = FromTruth();
  still.disturbance.wave = sim::Wave::kNone;
  sim::LineTrackingPlant plant(still);
  std::vector<double> errors_mm = sim::HeldOutTipErrors(plant, known, 100, 1);
  std::ranges::sort(errors_mm);
  EXPECT_LT(errors_mm[50], 1.0) << "the arm is off by 4.5 mm in the mean";

  std::vector<std::string> command = Console();
  command.insert(command.end(), {"--calibration", (folder_ / "calibration.dfr").string()});
  const test::PeerProcess console(command);
  std::optional<Surgeon> surgeon;
  imitation::DemonstrationSet set;
  for (const bool teleoperation : {false, true}) {
    const std::filesystem::path file = folder_ / (teleoperation ? "led.hdf5" : "driven.hdf5");
    Program program(folder_.path, "demonstrate --config " + config_.string() + " --out " +
                                      file.string() + " --count 1 --steps 45" +
                                      (teleoperation ? " --teleoperation" : ""));
    if (!teleoperation) {
      ASSERT_EQ(program.Await({"type home"}), 0) << program.Shown();
      program.Type("home\n");
    }
    bool done = false;
    for (std::uint64_t seed = 1; seed < 6 && !done; ++seed) {
      ASSERT_TRUE(program.Begin([&] {
        surgeon.reset();  // no other participant may command the arm from here on
        Place(seed);
        if (teleoperation) surgeon.emplace(domain_);
      })) << program.Shown();
      for (int n = 0; teleoperation && n < 120; ++n) {
        const double off = surgeon->link().Truth().distance_m;
        surgeon->Lead(surgeon->at() + Eigen::Vector3d(0.0005, -0.5 * off, 0.0), 0.006);
        if (program.Shown().find("1 of 1") != std::string::npos) break;
      }
      done = program.Await({"1 of 1", "the demonstration is discarded"}, kEpisode) == 0;
    }
    ASSERT_TRUE(done) << program.Shown();
    EXPECT_EQ(program.End(), 0);
    surgeon.reset();
    imitation::DemonstrationSet one = imitation::LoadRobomimic(file);
    EXPECT_EQ(one.provenance, Own());
    ASSERT_EQ(one.trajectories.size(), 1U);
    EXPECT_GT(one.trajectories[0].states(45, 0) - one.trajectories[0].states(0, 0), 38.0);
    if (teleoperation) {
      set.trajectories.push_back(one.trajectories[0]);
    } else {
      set = std::move(one);
    }
  }
  // An operator of a robot records fifty demonstrations. Simulated demonstrations save time here.
  for (const core::Trajectory& more : Demonstrate(FromTruth(), known, 8, 45, 1).trajectories) {
    set.trajectories.push_back(more);
  }
  FitOptions fit;
  fit.demonstrations = folder_ / "all.hdf5";
  imitation::SaveRobomimic(set, fit.demonstrations);
  fit.out = folder_ / "model";
  fit.model.hidden = {8};
  fit.model.gammas = {0.5};
  fit.model.horizon = 45;
  RunFit(fit);

  Program program(folder_.path, "run --config " + config_.string() + " --episodes 5");
  const std::vector<std::string> outcomes = {"  completed", "  halted", "  collided"};
  for (int outcome = 1; outcome == 1;) {
    ASSERT_TRUE(program.Begin([&] { Place(5); })) << program.Shown();
    outcome = program.Await(outcomes, kEpisode);
    ASSERT_TRUE(outcome == 0 || outcome == 1) << program.Shown();
  }
  program.Type("q\n");
  EXPECT_EQ(program.Await({"baseline: 1 completed"}), 0) << program.Shown();
  EXPECT_EQ(program.Shown().find("origin"), std::string::npos) << program.Shown();
  EXPECT_EQ(program.End(), 0) << program.Shown();
}

}  // namespace
}  // namespace dfr::apps::line_tracking
