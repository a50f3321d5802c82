#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

#include "commands/commands.h"
#include "robot/robot_config.h"

namespace dfr::apps::line_tracking {
namespace {

using Clock = std::chrono::steady_clock;

std::atomic<bool> stopping = false;
static_assert(std::atomic<bool>::is_always_lock_free);

void NoteStop(int /*signal*/) { stopping = true; }

/// A child program. Prints its output line by line after its name. The child ends when this process
/// ends, even if this process is killed.
class Child {
 public:
  Child(std::string name, const std::vector<std::string>& command) : name_(std::move(name)) {
    std::array<int, 2> ends{};
    if (pipe2(ends.data(), O_CLOEXEC) != 0) Fail("cannot create a pipe");
    std::vector<char*> arguments;
    arguments.reserve(command.size() + 1);
    for (const std::string& argument : command) {
      arguments.push_back(const_cast<char*>(argument.c_str()));
    }
    arguments.push_back(nullptr);
    const pid_t parent = getpid();
    pid_ = fork();
    if (pid_ < 0) Fail("cannot be started");
    if (pid_ == 0) {
      // A separate process group: Ctrl-C reaches only this process, which stops all children in
      // order.
      setpgid(0, 0);
      prctl(PR_SET_PDEATHSIG, SIGINT);
      if (getppid() != parent) _exit(1);
      dup2(ends[1], STDOUT_FILENO);
      dup2(ends[1], STDERR_FILENO);
      const int nothing = open("/dev/null", O_RDONLY);
      if (nothing >= 0) dup2(nothing, STDIN_FILENO);
      execv(arguments[0], arguments.data());
      const std::string reason = std::string(arguments[0]) + ": " + std::strerror(errno) + "\n";
      static_cast<void>(write(STDERR_FILENO, reason.data(), reason.size()));
      _exit(127);
    }
    close(ends[1]);
    output_ = ends[0];
  }
  ~Child() {
    Stop(SIGINT);
    if (output_ >= 0) close(output_);
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  [[nodiscard]] int output() const noexcept { return output_; }
  [[nodiscard]] bool running() const noexcept { return pid_ > 0; }
  /// Exit status; 0 after success.
  [[nodiscard]] int status() const noexcept { return status_; }

  /// Prints the child's new output. Returns false at the end of the output.
  bool Show() {
    std::array<char, 4096> buffer;
    const ssize_t size = read(output_, buffer.data(), buffer.size());
    if (size < 0 && errno == EINTR) return true;
    if (size <= 0) {
      if (!line_.empty()) Print();
      close(output_);
      output_ = -1;
      return false;
    }
    for (ssize_t i = 0; i < size; ++i) {
      const char letter = buffer[static_cast<std::size_t>(i)];
      if (letter == '\n') {
        Print();
      } else {
        line_ += letter;
      }
    }
    return true;
  }

  /// Checks whether the child has ended, and prints the reason unless Stop() ended it.
  void Look() {
    int how = 0;
    if (pid_ <= 0 || waitpid(pid_, &how, WNOHANG) != pid_) return;
    Ended(how);
  }

  /// Asks the child to end, and kills it after five seconds.
  void Stop(int with) {
    if (pid_ <= 0) return;
    asked_ = true;
    kill(pid_, with);
    const auto end = Clock::now() + std::chrono::seconds(5);
    int how = 0;
    while (waitpid(pid_, &how, WNOHANG) != pid_) {
      if (Clock::now() > end) {
        std::cout << "[" << name_ << "] does not end: killed" << std::endl;
        kill(pid_, SIGKILL);
        waitpid(pid_, &how, 0);
        break;
      }
      pollfd output{output_, POLLIN, 0};
      if (output_ >= 0 && poll(&output, 1, 20) > 0) {
        Show();
      } else if (output_ < 0) {
        usleep(20'000);
      }
    }
    Ended(how);
    while (output_ >= 0 && Show()) {
    }
  }

 private:
  [[noreturn]] void Fail(const char* what) const {
    throw std::runtime_error(name_ + " " + what + ": " + std::strerror(errno));
  }
  void Print() {
    std::cout << "[" << name_ << "] " << line_ << std::endl;
    line_.clear();
  }
  void Ended(int how) {
    pid_ = -1;
    status_ = WIFEXITED(how) ? WEXITSTATUS(how) : 128 + WTERMSIG(how);
    if (asked_ && status_ == 0) return;
    if (WIFSIGNALED(how)) {
      std::cout << "[" << name_ << "] was killed by signal " << WTERMSIG(how) << std::endl;
    } else if (!asked_ || status_ != 0) {
      std::cout << "[" << name_ << "] ended with status " << status_ << std::endl;
    }
  }

  std::string name_;
  pid_t pid_ = -1;
  int output_ = -1;
  int status_ = 0;
  bool asked_ = false;
  std::string line_;
};

std::string Beside(const char* program) {
  const std::filesystem::path path =
      std::filesystem::read_symlink("/proc/self/exe").parent_path() / program;
  if (!std::filesystem::exists(path)) {
    throw std::runtime_error(path.string() + " does not exist: build it with ./dev build " +
                             program);
  }
  return path.string();
}

// Returns `command` with the options that make it participant `name` of the run's network. With
// security, the folders of that participant and of the run are side by side, as `hardware
// certificates` creates them.
std::vector<std::string> InNetwork(std::vector<std::string> command,
                                   const dds::ParticipantOptions& network,
                                   const std::string& name) {
  command.insert(command.end(), {"--domain", std::to_string(network.domain)});
  if (network.discovery == dds::Discovery::kNetwork) {
    command.insert(command.end(), {"--discovery", "network"});
  } else if (network.discovery == dds::Discovery::kServerClient) {
    command.insert(command.end(), {"--discovery", "server", "--server", network.server_address});
  }
  if (network.security.empty()) return command;
  const std::filesystem::path folder = (network.security / "." / ".." / name).lexically_normal();
  if (!std::filesystem::exists(folder)) {
    throw std::runtime_error(
        folder.string() +
        " does not exist, but must hold the certificate of the launched program. Create the "
        "certificates of line_tracking and " +
        name + " with `hardware certificates`");
  }
  command.insert(command.end(), {"--security", folder.string()});
  return command;
}

// Makes a missing calibration or model, like the commands calibrate, demonstrate and fit.
void Prepare(const RobotConfig& config, const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  SceneOptions scene;
  scene.calibration = config.calibration;
  if (config.calibration != kNoCalibration && !std::filesystem::exists(config.calibration)) {
    std::cout << "Calibrating: " << config.calibration.string() << std::endl;
    CalibrateOptions calibrate;
    calibrate.scene = scene;
    calibrate.out = config.calibration;
    RunCalibrate(calibrate);
  }
  if (std::filesystem::exists(config.model)) return;
  const std::filesystem::path demonstrations = folder / "demonstrations.hdf5";
  if (!std::filesystem::exists(demonstrations)) {
    std::cout << "Demonstrating: " << demonstrations.string() << std::endl;
    DemonstrateOptions demonstrate;
    demonstrate.scene = scene;
    demonstrate.out = demonstrations;
    RunDemonstrate(demonstrate);
  }
  std::cout << "Fitting: " << config.model.string() << std::endl;
  FitOptions fit;
  fit.demonstrations = demonstrations;
  fit.out = config.model;
  RunFit(fit);
}

}  // namespace

std::vector<std::string> SimulatorArguments(const RobotConfig& config) {
  std::vector<std::string> arguments = {"--arm", config.arm, "--wave", "random"};
  if (config.calibration != kNoCalibration) {
    arguments.insert(arguments.end(), {"--calibration", config.calibration.string()});
  }
  if (config.lock_step) {
    arguments.emplace_back("--lock-step");
  } else {
    arguments.insert(arguments.end(), {"--priority", std::to_string(config.priority)});
  }
  return arguments;
}

void RunLaunch(const LaunchOptions& options) {
  const RobotConfig config = RobotConfig::Load(options.config);
  if (config.robot != RobotPlace::kDds || !config.simulator) {
    throw std::runtime_error(
        options.config.string() +
        ": launch starts the simulated robot; this configuration is for another "
        "robot. Start its console yourself, then `line_tracking run --config`");
  }
  Prepare(config, options.folder);
  struct sigaction action {};
  action.sa_handler = NoteStop;
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);

  std::vector<std::string> simulate = SimulatorArguments(config);
  simulate.insert(simulate.begin(), Beside("dvrk_simulator"));
  std::vector<std::string> run = {Beside("line_tracking"),
                                  "run",
                                  "--config",
                                  options.config.string(),
                                  "--episodes",
                                  std::to_string(options.episodes),
                                  "--seed",
                                  std::to_string(options.seed)};
  Child simulator("simulator", InNetwork(simulate, config.network, "dvrk_simulator"));
  Child stop("stop",
             InNetwork({Beside("hardware"), "stop", "--unattended"}, config.network, "stop"));
  Child client("robot", run);
  const std::array<Child*, 3> all = {&client, &simulator, &stop};
  while (client.running() && !stopping) {
    std::array<pollfd, 3> outputs{};
    for (std::size_t i = 0; i < all.size(); ++i) outputs[i] = {all[i]->output(), POLLIN, 0};
    if (poll(outputs.data(), outputs.size(), 100) > 0) {
      for (std::size_t i = 0; i < all.size(); ++i) {
        if (outputs[i].fd >= 0 && outputs[i].revents != 0) all[i]->Show();
      }
    }
    for (Child* child : all) child->Look();
  }
  // Stops the robot's program first: it must hold while the others still run.
  for (Child* child : all) child->Stop(SIGINT);
  while (client.output() >= 0 && client.Show()) {
  }
  if (client.status() != 0) throw std::runtime_error("the run failed; its output is above");
}

}  // namespace dfr::apps::line_tracking
