#include "robot_site.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <stdexcept>
#include <thread>
#include <utility>

#include "dfr/runtime/periodic_timer.h"

namespace dfr::apps::line_tracking {

void SleepMs(double ms) {
  std::this_thread::sleep_for(std::chrono::microseconds(std::lround(1e3 * ms)));
}

// -- programs -------------------------------------------------------------------------------------

Program::Program(const std::vector<std::string>& command, const bench::LossyWire* wire) {
  std::array<int, 2> in{};
  std::array<int, 2> out{};
  if (pipe2(in.data(), O_CLOEXEC) != 0 || pipe2(out.data(), O_CLOEXEC) != 0) {
    throw std::runtime_error("cannot create a pipe");
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

Program::~Program() {
  Kill();
  close(input_);
  close(output_);
}

void Program::Signal(int number) const {
  if (pid_ > 0) kill(pid_, number);
}

void Program::Kill() {
  if (pid_ <= 0) return;
  kill(pid_, SIGCONT);
  kill(pid_, SIGKILL);
  waitpid(pid_, nullptr, 0);
  pid_ = -1;
}

void Program::Type(const std::string& text) const {
  if (write(input_, text.data(), text.size()) < 0)
    throw std::runtime_error("the program has closed its input");
}

std::optional<std::string> Program::Line() {
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

bool Program::Ended() const {
  siginfo_t info{};
  return pid_ > 0 &&
         waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
         info.si_pid == pid_;
}

double Program::resident_mb() const {
  std::ifstream in("/proc/" + std::to_string(pid_) + "/statm");
  double size = 0.0;
  double resident = 0.0;
  in >> size >> resident;
  return resident * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
}

// -- all programs ---------------------------------------------------------------------------------

Site::Site(std::filesystem::path folder, int domain, bench::LossyWire* wire_to_robot,
           double image_age_s, bool with_platform)
    : folder_(std::move(folder)),
      domain_(domain),
      image_age_s_(image_age_s),
      wire(wire_to_robot),
      participant(
          {.domain = domain,
           .discovery = wire != nullptr ? dds::Discovery::kNetwork : dds::Discovery::kLoopback}) {
  StartSimulator();
  StartStop();
  if (with_platform) {
    StartPlatform();
  } else {
    StartRobot();
  }
}

void Site::StartPlatform() {
  robot.reset();
  platform.emplace();
  StartRobot();
}

void Site::StartSimulator(double homing_s) {
  link.reset();
  simulator.reset();
  simulator.emplace(
      std::vector<std::string>{DFR_SIMULATOR, "--domain", std::to_string(domain_), "--discovery",
                               discovery(), "--homing", std::to_string(homing_s), "--wave",
                               "random", "--calibration", (folder_ / "calibration.dfr").string()});
  link.emplace(participant);
  link->Await(30.0);
}

void Site::StartStop() {
  stop.reset();
  stop.emplace(std::vector<std::string>{DFR_HARDWARE, "stop", "--domain", std::to_string(domain_),
                                        "--discovery", discovery()},
               wire);
}

void Site::StartRobot() {
  robot.reset();
  std::vector<std::string> command = {std::filesystem::read_symlink("/proc/self/exe").string(),
                                      "--robot",
                                      folder_.string(),
                                      "--domain",
                                      std::to_string(domain_),
                                      "--image-age",
                                      std::to_string(image_age_s_)};
  if (wire != nullptr) command.emplace_back("--far");
  if (platform) command.insert(command.end(), {"--platform", platform->device()});
  robot.emplace(command, wire);
  state_ = "idle";
}

void Site::Listen() {
  while (std::optional<std::string> line = robot->Line()) {
    if (std::sscanf(line->c_str(), "loop %lld %lld %lf", &loop_times_.periods,
                    &loop_times_.left_out, &loop_times_.worst_ms) == 3) {
      ++episodes_;
      continue;
    }
    std::array<char, 32> to{};
    std::array<char, 64> reason{};
    long long ns = 0;
    if (std::sscanf(line->c_str(), "%lld %31s %63s", &ns, to.data(), reason.data()) != 3) continue;
    if (std::string(to.data()) == "broken") {
      broken_ns_ = ns;
      continue;
    }
    state_ = to.data();
    if (std::string(reason.data()) != "none" && !told_) {
      told_ = reason.data();
      told_ns_ = ns;
    }
    if (state_ == "running" && told_ && !ToldOfAnEnd()) ++restarts_;
  }
  while (std::optional<std::string> line = stop->Line()) {
    if (line->find("SILENT") != std::string::npos && !operator_ns_) {
      operator_ns_ = runtime::SteadyNow();
    }
  }
}

void Site::AwaitMotion() {
  const std::int64_t end_ns = runtime::SteadyNow() + 60'000'000'000;
  for (std::int64_t asked_ns = 0; !Moving(); SleepMs(2)) {
    Listen();
    if (runtime::SteadyNow() > end_ns) {
      throw std::runtime_error("the robot does not start: " + told_.value_or(state_));
    }
    if (Stands() && runtime::SteadyNow() - asked_ns > 500'000'000) {
      robot->Type("go\n");
      asked_ns = runtime::SteadyNow();
    }
  }
}

void Site::AwaitHoming() {
  const std::int64_t end_ns = runtime::SteadyNow() + 60'000'000'000;
  dds::OperatingState state;
  while (operating_state.Take(state)) {
  }
  for (state = {}; state.state != "ENABLED" || state.is_homed; SleepMs(2)) {
    if (runtime::SteadyNow() > end_ns) throw std::runtime_error("the robot does not home the arm");
    while (operating_state.Take(state)) {
    }
  }
}

void Site::Forget() {
  Listen();
  told_.reset();
  operator_ns_.reset();
  broken_ns_.reset();
  restarts_ = 0;
}

std::map<std::string, double> Site::Memory() const {
  return {{"robot's program", robot->resident_mb()},
          {"console", simulator->resident_mb()},
          {"emergency stop", stop->resident_mb()}};
}

}  // namespace dfr::apps::line_tracking
