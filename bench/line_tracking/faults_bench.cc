// What happens when something goes wrong while line tracking runs over the network: each fault many
// times at random moments of motion, in one table. The robot's program is this one with --robot.
#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <iostream>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "commands.h"
#include "dfr/control/rollout.h"
#include "dfr/core/build_info.h"
#include "dfr/core/quantile.h"
#include "dfr/core/random.h"
#include "dfr/dds/channel.h"
#include "dfr/runtime/periodic_timer.h"
#include "lossy_wire.h"
#include "recorded_controller.h"
#include "robot_plant.h"
#include "simulator_link.h"
#include "trial_runner.h"

namespace dfr::apps::line_tracking {
namespace {

constexpr double kMillisecond = 1e6;  // ns

void SleepMs(double ms) {
  std::this_thread::sleep_for(std::chrono::microseconds(std::lround(1e3 * ms)));
}

// -- the robot's program ------------------------------------------------------------------------

std::atomic<bool> policy_is_broken = false;

// A policy that says NaN from some moment on.
class BreakingPolicy final : public control::Controller {
 public:
  explicit BreakingPolicy(control::Controller& inner) : inner_(&inner) {}
  [[nodiscard]] int state_dim() const noexcept override { return inner_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return inner_->control_dim(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override { inner_->Reset(seed); }
  [[nodiscard]] control::Step DoNext(std::span<const double> x,
                                     std::span<double> u) noexcept override {
    const control::Step step = inner_->Next(x, u);
    if (!policy_is_broken) said_ = false;
    if (policy_is_broken) {
      if (!said_) {
        std::printf("%lld broken none\n", static_cast<long long>(runtime::SteadyNow()));
        std::fflush(stdout);
      }
      said_ = true;
      std::fill(u.begin(), u.end(), std::numeric_limits<double>::quiet_NaN());
    }
    return step;
  }
  control::Controller* inner_;
  bool said_ = false;
};

RobotConfig Configuration(int domain, dds::Discovery discovery) {
  RobotConfig config;
  config.robot = RobotPlace::kDds;
  config.network.domain = domain;
  config.network.discovery = discovery;
  config.simulator = true;
  config.image_max_age_s = 0.07;
  return config;
}

// Episode after episode until something makes it hold; then waits for "go" on its input.
void RunRobot(const std::filesystem::path& folder, int domain, dds::Discovery discovery) {
  const LineModel model = LineModel::Load(folder / "model");
  const RobotConfig config = Configuration(domain, discovery);
  if (const std::string refused = runtime::AskForRealTime(config.priority); !refused.empty()) {
    std::cout << "note " << refused << std::endl;
  }
  RunOperator screen;
  screen.on_transition = [](const runtime::Transition& t) {
    std::printf("%lld %s %s %s\n", static_cast<long long>(t.steady_ns), runtime::Name(t.to),
                runtime::Name(t.reason), t.detail.data());
    std::fflush(stdout);
  };
  RobotPlant plant(config, line_task::LineCalibration::Load(folder / "calibration.dfr"), nullptr,
                   screen);
  static_cast<void>(runtime::AskForRealTime(config.priority + 1));
  plant.BringUp({});
  const std::unique_ptr<control::Controller> guided = model.MakeController("guided");
  BreakingPolicy breaking(*guided);
  RecordedController controller(breaking, nullptr);
  controller.on_decision = [&plant](const control::Step& step) { plant.loop().Decided(step); };
  for (std::uint64_t episode = 0;; ++episode) {
    const control::RolloutResult result =
        control::Rollout(plant, controller, {.plant_seed = episode, .controller_seed = episode});
    if (result.halt_cause == control::HaltCause::kControlInvalid) {
      plant.loop().Hold(runtime::HoldReason::kControlInvalid, "the policy's control is not finite");
    }
    while (!plant.loop().ended_regularly()) {
      pollfd input{STDIN_FILENO, POLLIN, 0};
      plant.loop().Idle(0.02);
      std::array<char, 64> text;
      if (poll(&input, 1, 0) <= 0 || read(STDIN_FILENO, text.data(), text.size()) <= 0) continue;
      policy_is_broken = false;
      if (plant.loop().state() == runtime::RunState::kFaulted && !plant.Clear()) continue;
      break;
    }
  }
}

// -- programs beside it -------------------------------------------------------------------------

/// A program with pipes to its input and from its output.
class Program {
 public:
  /// @param wire  whose far host it runs on; nullptr: here.
  explicit Program(const std::vector<std::string>& command,
                   const bench::LossyWire* wire = nullptr) {
    std::array<int, 2> in{};
    std::array<int, 2> out{};
    if (pipe2(in.data(), O_CLOEXEC) != 0 || pipe2(out.data(), O_CLOEXEC) != 0) {
      throw std::runtime_error("no pipe");
    }
    pid_ = fork();
    if (pid_ == 0) {
      prctl(PR_SET_PDEATHSIG, SIGKILL);
      dup2(in[0], STDIN_FILENO);
      dup2(out[1], STDOUT_FILENO);
      if (wire != nullptr && !wire->EnterFarHost()) _exit(126);
      std::vector<char*> arguments;
      arguments.reserve(command.size() + 1);
      for (const std::string& argument : command) {
        arguments.push_back(const_cast<char*>(argument.c_str()));
      }
      arguments.push_back(nullptr);
      execv(arguments[0], arguments.data());
      _exit(127);
    }
    close(in[0]);
    close(out[1]);
    input_ = in[1];
    output_ = out[0];
    fcntl(output_, F_SETFL, O_NONBLOCK);
  }
  ~Program() {
    Kill();
    close(input_);
    close(output_);
  }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  void Signal(int number) const {
    if (pid_ > 0) kill(pid_, number);
  }
  void Kill() {
    if (pid_ <= 0) return;
    kill(pid_, SIGCONT);
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
    pid_ = -1;
  }
  void Type(const std::string& text) const {
    if (write(input_, text.data(), text.size()) < 0) throw std::runtime_error("nobody reads");
  }
  /// The next whole line that it has printed, without waiting.
  std::optional<std::string> Line() {
    std::array<char, 4096> buffer;
    for (ssize_t size = 0; (size = read(output_, buffer.data(), buffer.size())) > 0;) {
      text_.append(buffer.data(), static_cast<std::size_t>(size));
    }
    const std::size_t end = text_.find('\n');
    if (end == std::string::npos) return std::nullopt;
    std::string line = text_.substr(0, end);
    text_.erase(0, end + 1);
    return line;
  }

 private:
  pid_t pid_ = -1;
  int input_ = -1;
  int output_ = -1;
  std::string text_;
};

// -- one fault after the other ------------------------------------------------------------------

/// All processes of a run, and what each has said last.
class Site {
 public:
  /// @param wire  at whose far end the robot's program and its emergency stop are; nullptr: all of
  ///   them are on one host.
  Site(std::filesystem::path folder, int domain, bench::LossyWire* wire_to_robot)
      : folder_(std::move(folder)),
        domain_(domain),
        wire(wire_to_robot),
        participant(
            {.domain = domain,
             .discovery = wire != nullptr ? dds::Discovery::kNetwork : dds::Discovery::kLoopback}) {
    StartSimulator();
    StartStop();
    StartRobot();
  }

  void StartSimulator() {
    link.reset();
    simulator.reset();
    simulator.emplace(std::vector<std::string>{
        DFR_SIMULATOR, "--domain", std::to_string(domain_), "--discovery", discovery(), "--homing",
        "0.1", "--wave", "random", "--calibration", (folder_ / "calibration.dfr").string()});
    link.emplace(participant);
    link->Await(30.0);
  }
  void StartStop() {
    stop.reset();
    stop.emplace(std::vector<std::string>{DFR_HARDWARE, "stop", "--domain", std::to_string(domain_),
                                          "--discovery", discovery()},
                 wire);
  }
  void StartRobot() {
    robot.reset();
    std::vector<std::string> command = {std::filesystem::read_symlink("/proc/self/exe").string(),
                                        "--robot", folder_.string(), "--domain",
                                        std::to_string(domain_)};
    if (wire != nullptr) command.emplace_back("--far");
    robot.emplace(command, wire);
    state_ = "idle";
  }

  /// Reads what the robot's program and the stop have printed.
  void Listen() {
    while (std::optional<std::string> line = robot->Line()) {
      std::array<char, 32> to{};
      std::array<char, 64> reason{};
      long long ns = 0;
      if (std::sscanf(line->c_str(), "%lld %31s %63s", &ns, to.data(), reason.data()) != 3)
        continue;
      if (std::string(to.data()) == "broken") {
        broken_ns_ = ns;
        continue;
      }
      state_ = to.data();
      if (std::string(reason.data()) != "none" && !told_) {
        told_ = reason.data();
        told_ns_ = ns;
      }
      if (state_ == "running" && told_) ++restarts_;
    }
    while (std::optional<std::string> line = stop->Line()) {
      if (line->find("SILENT") != std::string::npos && !operator_ns_) {
        operator_ns_ = runtime::SteadyNow();
      }
    }
  }
  [[nodiscard]] int domain() const { return domain_; }
  [[nodiscard]] bool Moving() const { return state_ == "running" || state_ == "recovering"; }

  /// Until the robot moves. @throws std::runtime_error if it does not within a minute.
  void AwaitMotion() {
    const std::int64_t end_ns = runtime::SteadyNow() + 60'000'000'000;
    for (std::int64_t asked_ns = 0; !Moving(); SleepMs(2)) {
      Listen();
      if (runtime::SteadyNow() > end_ns) throw std::runtime_error("the robot does not start");
      if ((state_ == "holding" || state_ == "faulted") &&
          runtime::SteadyNow() - asked_ns > 500'000'000) {
        robot->Type("go\n");
        asked_ns = runtime::SteadyNow();
      }
    }
  }
  void Forget() {
    Listen();
    told_.reset();
    operator_ns_.reset();
    broken_ns_.reset();
    restarts_ = 0;
  }

  [[nodiscard]] const std::optional<std::string>& told() const { return told_; }
  [[nodiscard]] std::int64_t told_ns() const { return told_ns_; }
  [[nodiscard]] const std::optional<std::int64_t>& operator_ns() const { return operator_ns_; }
  /// When the policy first said NaN.
  [[nodiscard]] const std::optional<std::int64_t>& broken_ns() const { return broken_ns_; }
  [[nodiscard]] int restarts() const { return restarts_; }

 private:
  [[nodiscard]] std::string discovery() const { return wire != nullptr ? "network" : "loopback"; }

  std::filesystem::path folder_;
  int domain_;
  std::string state_;
  std::optional<std::string> told_;
  std::int64_t told_ns_ = 0;
  std::optional<std::int64_t> operator_ns_;
  std::optional<std::int64_t> broken_ns_;
  int restarts_ = 0;

 public:
  bench::LossyWire* wire;
  dds::Participant participant;
  dds::Publisher<dds::Flag> following{participant, "/MTMR_PSM1/following", dds::Role::kEvent};
  dds::Publisher<dds::Joy> clutch{participant, "/PSM1/arm_clutch", dds::Role::kEvent};
  dds::Publisher<dds::Signal> hold{participant, "/PSM1/hold", dds::Role::kRequest};
  std::optional<Program> simulator;
  std::optional<Program> stop;
  std::optional<Program> robot;
  std::optional<SimulatorLink> link;
};

struct Fault {
  std::string name;
  std::function<void(Site&)> begin;
  std::function<void(Site&)> end;
  bool blind = false;        ///< The simulator cannot be asked meanwhile: it stands still.
  bool to_operator = false;  ///< The robot's program itself fails: the operator's screen tells.
  bool wire = false;         ///< Between two hosts, where the system allows to have two.
  bool harmless = false;     ///< Nothing may come of it: counted where the run goes on.
};

Fault Injected(const std::string& name, const std::string& fault, const std::string& on,
               const std::string& off) {
  return {name, [=](Site& s) { s.link->Fault(fault, on); },
          [=](Site& s) { s.link->Fault(fault, off); }, false, false};
}

// A bad cable; on one host, what it does to the measured state.
Fault Lossy(const std::string& name, double loss) {
  const auto set = [](Site& s, double share, double jitter_s) {
    if (s.wire != nullptr) {
      s.wire->Disturb(share, jitter_s);
    } else {
      s.link->Fault("drop", std::to_string(share));
      s.link->Fault("jitter", std::to_string(jitter_s));
    }
  };
  return {
      name, [=](Site& s) { set(s, loss, 0.05); }, [=](Site& s) { set(s, 0.0, 0.0); }, false, false,
      true};
}

// A message of 82 bytes with one of Fast DDS' own statistics, to every port that a process of the
// domain may listen at. Without a filter Debian's Fast DDS ends the process.
void SendPacket(int domain) {
  std::array<std::uint8_t, 82> packet = {'R', 'T', 'P', 'S', 2, 3, 1, 15};
  packet[20] = 0x80;
  packet[21] = 1;
  packet[22] = 58;
  const int out = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  sockaddr_in to{};
  to.sin_family = AF_INET;
  to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  for (int offset = 0; offset < 60; ++offset) {
    to.sin_port = htons(static_cast<std::uint16_t>(7400 + 250 * domain + offset));
    static_cast<void>(sendto(out, packet.data(), packet.size(), MSG_NOSIGNAL,
                             reinterpret_cast<const sockaddr*>(&to), sizeof to));
  }
  close(out);
}

std::vector<Fault> Faults() {
  std::vector<Fault> faults;
  faults.push_back({"kill-robot", [](Site& s) { s.robot->Signal(SIGKILL); },
                    [](Site& s) { s.StartRobot(); }, false, true});
  faults.push_back({"stop-robot", [](Site& s) { s.robot->Signal(SIGSTOP); },
                    [](Site& s) { s.robot->Signal(SIGCONT); }, false, true});
  faults.push_back({"kill-console", [](Site& s) { s.simulator->Kill(); },
                    [](Site& s) {
                      s.StartSimulator();
                      s.link->Reset(1);  // homes the arm
                    },
                    true, false});
  faults.push_back({"stop-console", [](Site& s) { s.simulator->Signal(SIGSTOP); },
                    [](Site& s) { s.simulator->Signal(SIGCONT); }, true, false});
  faults.push_back({"kill-stop-button", [](Site& s) { s.stop->Kill(); },
                    [](Site& s) { s.StartStop(); }, false, false});
  faults.push_back({"stop-stop-button", [](Site& s) { s.stop->Signal(SIGSTOP); },
                    [](Site& s) { s.stop->Signal(SIGCONT); }, false, false});
  faults.push_back({"emergency-stop", [](Site& s) { s.stop->Type("\n"); },
                    [](Site& s) { s.stop->Type("r\n"); }, false, false});
  faults.push_back(Lossy("loss-5-jitter-50ms", 0.05));
  faults.push_back(Lossy("loss-15-jitter-50ms", 0.15));
  faults.push_back(Lossy("loss-30-jitter-50ms", 0.3));
  faults.push_back(Injected("frozen-image", "camera", "frozen", "none"));
  faults.push_back(Injected("black-image", "camera", "black", "none"));
  faults.push_back(Injected("no-image", "camera", "silent", "none"));
  faults.push_back(Injected("stamp-zero", "invalid", "1", "0"));
  faults.push_back(Injected("nan-pose", "corrupt", "1", "0"));
  faults.push_back(Injected("frozen-state", "freeze", "1", "0"));
  faults.push_back(Injected("no-state", "silent", "1", "0"));
  faults.push_back(Injected("clock-ahead-1s", "clock_jump", "1", "0"));
  faults.push_back(Injected("clock-behind-1s", "clock_jump", "-1", "0"));
  faults.push_back(
      {"nan-policy", [](Site& s) { s.robot->Signal(SIGUSR1); }, [](Site&) {}, false, false});
  faults.push_back({"arm-fault", [](Site& s) { s.link->Fault("arm_fault", "overcurrent"); },
                    [](Site& s) { s.link->Reset(1); }, false, false});
  const auto second = std::make_shared<std::optional<dds::Publisher<dds::PoseStamped>>>();
  faults.push_back(
      {"second-commander",
       [second](Site& s) { second->emplace(s.participant, "/PSM1/servo_cp", dds::Role::kCommand); },
       [second](Site&) { second->reset(); }, false, false});
  faults.push_back(Injected("frozen-noisy-image", "camera", "frozen_noisy", "none"));
  faults.push_back(Injected("image-late-1s", "camera", "late", "none"));
  // Another hand on the arm. What others say and how they stand is published beforehand, as a
  // console does.
  faults.push_back({"teleoperation", [](Site& s) { s.following.Write({true}); },
                    [](Site& s) { s.following.Write({false}); }, false, false});
  faults.push_back({"clutch",
                    [](Site& s) {
                      s.clutch.Write({{}, "", {}, {1}});
                    },
                    [](Site& s) {
                      s.clutch.Write({{}, "", {}, {0}});
                    },
                    false, false});
  faults.push_back({"foreign-hold", [](Site& s) { s.hold.Write({}); }, [](Site&) {}, false, false});
  const auto console = std::make_shared<std::optional<dds::Publisher<dds::JointState>>>();
  faults.push_back({"second-console",
                    [console](Site& s) {
                      console->emplace(s.participant, "/PSM1/measured_js", dds::Role::kState);
                    },
                    [console](Site&) { console->reset(); }, false, false});
  // Faster than the tip may follow.
  faults.push_back(Injected("moving-platform", "platform", "0.06", "0"));
  faults.push_back(
      {"packet", [](Site& s) { SendPacket(s.domain()); }, [](Site&) {}, false, false, false, true});
  return faults;
}

struct Row {
  int trials = 0;
  int detected = 0;
  int restarts = 0;
  std::set<std::string> told;
  std::vector<double> detection_ms;  // until the robot's program holds, or the operator is told
  std::vector<double> rest_ms;       // until the tip is at rest
  std::vector<double> motion_mm;     // of the tip, at most
};

double Quantile(std::vector<double> values, double q) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  return core::Quantile(values, q);
}

void Try(Site& site, const Fault& fault, core::Random& random, Row& row) {
  constexpr double kObserved = 700.0;  // ms
  constexpr double kStill = 0.02;      // mm: less is rounding and noise
  site.AwaitMotion();
  SleepMs(random.Uniform(200.0, 900.0));
  for (site.Forget(); !site.Moving(); site.Forget()) site.AwaitMotion();  // between two episodes

  Eigen::Vector3d before = site.link->Truth().tip_m;
  const std::int64_t start_ns = runtime::SteadyNow();
  fault.begin(site);
  struct Sample {
    double ms;
    Eigen::Vector3d tip_m;
  };
  std::vector<Sample> samples;
  const auto now_ms = [&] {
    return static_cast<double>(runtime::SteadyNow() - start_ns) / kMillisecond;
  };
  while (now_ms() < kObserved) {
    site.Listen();
    if (!fault.blind) samples.push_back({now_ms(), site.link->Truth().tip_m});
    SleepMs(1.0);
  }
  fault.end(site);
  // What was held up may come now, and nothing may begin anew.
  for (const double end_ms = now_ms() + 300.0; now_ms() < end_ms; SleepMs(2.0)) {
    site.Listen();
    samples.push_back({now_ms(), site.link->Truth().tip_m});
  }

  // A broken policy does no harm before it is asked.
  const double since_ms =
      site.broken_ns() ? static_cast<double>(*site.broken_ns() - start_ns) / kMillisecond : 0.0;
  std::erase_if(samples, [&](const Sample& sample) { return sample.ms < since_ms; });
  if (site.broken_ns()) before = samples.front().tip_m;

  ++row.trials;
  row.restarts += site.restarts();
  const bool told = fault.to_operator ? site.operator_ns().has_value() : site.told().has_value();
  if (fault.harmless) {
    // An episode may end meanwhile, and does so for its own reasons.
    const bool ended =
        site.told() && *site.told() != "controller-halted" && *site.told() != "not-seen";
    row.detected += ended || site.operator_ns() ? 0 : 1;
    row.restarts = 0;
    row.told.insert(ended ? *site.told() : "nothing: the run goes on");
    return;
  }
  if (told) {
    ++row.detected;
    const std::int64_t ns = fault.to_operator ? *site.operator_ns() : site.told_ns();
    // A period's hold reasons carry the time of its beginning.
    row.detection_ms.push_back(
        std::max(0.0, static_cast<double>(ns - start_ns) / kMillisecond - since_ms));
    row.told.insert(fault.to_operator ? "operator's screen" : *site.told());
  }
  double motion_mm = 0.0;
  double rest_ms = 0.0;
  const Eigen::Vector3d last = samples.back().tip_m;
  // A simulator that was started anew is another arm.
  if (fault.name != "kill-console" && fault.name != "arm-fault") {
    for (const Sample& sample : samples) {
      motion_mm = std::max(motion_mm, 1e3 * (sample.tip_m - before).norm());
      if (1e3 * (sample.tip_m - last).norm() > kStill) rest_ms = sample.ms - since_ms;
    }
  }
  row.motion_mm.push_back(motion_mm);
  if (!fault.blind) row.rest_ms.push_back(rest_ms);
}

void Measure(const std::filesystem::path& folder, int domain, bench::LossyWire* wire, int trials,
             const std::vector<std::string>& only, std::uint64_t seed) {
  std::unique_ptr<Site> site;
  core::Random random(seed);
  constexpr double kTrialMinutes = 0.055;
  const std::size_t kinds = only.empty() ? Faults().size() : only.size();
  std::printf("%zu faults, %d times each: about %.0f minutes\n", kinds, trials,
              std::ceil(kTrialMinutes * static_cast<double>(kinds) * trials));
  std::printf("%-20s %6s %8s  %12s  %9s  %11s  %8s  %s\n", "fault", "trials", "detected",
              "after [ms]", "rest [ms]", "motion [mm]", "restarts", "what the operator is told");
  std::printf("%-20s %6s %8s  %12s  %9s  %11s\n", "", "", "", "p50     max", "max", "max");
  for (const Fault& fault : Faults()) {
    if (!only.empty() && std::find(only.begin(), only.end(), fault.name) == only.end()) continue;
    bench::LossyWire* const its_wire = fault.wire ? wire : nullptr;
    if (!site || site->wire != its_wire) {
      site.reset();
      site = std::make_unique<Site>(folder, domain, its_wire);
    }
    Row row;
    for (int i = 0; i < trials; ++i) Try(*site, fault, random, row);
    std::string told;
    for (const std::string& word : row.told) told += (told.empty() ? "" : ", ") + word;
    std::printf("%-20s %6d %8d  %5.0f %6.0f  %9.0f  %11.2f  %8d  %s\n", fault.name.c_str(),
                row.trials, row.detected, Quantile(row.detection_ms, 0.5),
                Quantile(row.detection_ms, 1.0), Quantile(row.rest_ms, 1.0),
                Quantile(row.motion_mm, 1.0), row.restarts, told.c_str());
    std::fflush(stdout);
  }
}

// A model and a calibration to run with.
void Prepare(const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  sim::LineTrackingOptions world;
  world.observation = sim::Observation::kGroundTruth;
  calibration::CalibrationSummary summary;
  const line_task::LineCalibration known = CalibratePlant(world, 100, 3, &summary);
  known.Save(folder / "calibration.dfr");
  LineModelOptions options;
  options.gammas = {0.5};
  LineModel::Fit(Demonstrate(world, known, 50, 50, 1), options).Save(folder / "model");
}

int Main(int argc, char** argv) {
  CLI::App app("Line tracking over the network while something goes wrong, as a table.",
               "faults_bench");
  std::filesystem::path robot;
  bool far = false;
  int domain = 97;
  int trials = 20;
  std::uint64_t seed = 1;
  std::vector<std::string> only;
  app.add_option("--trials", trials, "of each fault")->capture_default_str();
  app.add_option("--only", only, "these faults, separated by commas")->delimiter(',');
  app.add_option("--seed", seed, "of the moments")->capture_default_str();
  app.add_option("--domain", domain, "DDS domain that nobody else uses")->capture_default_str();
  app.add_option("--robot", robot)->group("");
  app.add_flag("--far", far)->group("");
  CLI11_PARSE(app, argc, argv);
  signal(SIGPIPE, SIG_IGN);
  if (!robot.empty()) {
    signal(SIGUSR1, [](int) { policy_is_broken = true; });
    RunRobot(robot, domain, far ? dds::Discovery::kNetwork : dds::Discovery::kLoopback);
    return EXIT_SUCCESS;
  }
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("faults_bench_" + std::to_string(getpid()));
  std::printf("commit %s, seed %llu\n", core::BuildCommit(), static_cast<unsigned long long>(seed));
  std::optional<bench::LossyWire> wire;
  try {
    wire.emplace(core::DeriveSeed(seed, {1}));
  } catch (const std::runtime_error& e) {
    std::printf("no network namespaces here (%s): losses and jitter are the console's own\n",
                e.what());
  }
  std::fflush(stdout);
  Prepare(folder);
  Measure(folder, domain, wire ? &*wire : nullptr, trials, only, seed);
  std::filesystem::remove_all(folder);
  return EXIT_SUCCESS;
}

}  // namespace
}  // namespace dfr::apps::line_tracking

int main(int argc, char** argv) try {
  return dfr::apps::line_tracking::Main(argc, argv);
} catch (const std::exception& e) {
  std::cerr << "faults_bench: " << e.what() << '\n';
  return EXIT_FAILURE;
}
