// Round-trip time of a command to another process over UDP on the loopback, with and without
// security. Both processes run this program. usage: round_trip_bench [Google Benchmark's options]
#include <benchmark/benchmark.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "dfr/core/numerics/quantile.h"
#include "dfr/dds/certificates.h"
#include "dfr/dds/channel.h"

namespace dfr::dds {
namespace {

using Clock = std::chrono::steady_clock;
constexpr const char* kAsk = "/PSM1/servo_cp";
constexpr const char* kAnswer = "/PSM1/setpoint_cp";
constexpr double kPatience_s = 10.0;

ParticipantOptions Options(int domain, const std::string& security) {
  return {.domain = domain, .name = "round_trip_bench", .security = security};
}

// Returns every command to the sender.
int Echo(int domain, const std::string& security) {
  Participant participant(Options(domain, security));
  Subscriber<PoseStamped> ask(participant, kAsk, Role::kCommand);
  Publisher<PoseStamped> answer(participant, kAnswer, Role::kCommand);
  PoseStamped pose;
  for (;;) {
    if (ask.Wait(1.0) && ask.Take(pose)) answer.Write(pose);
    if (::getppid() == 1) return EXIT_SUCCESS;  // orphaned
  }
}

// A child process that runs Echo() for the lifetime of this object.
class EchoProcess {
 public:
  EchoProcess(int domain, std::string security) {
    std::string self = std::filesystem::read_symlink("/proc/self/exe");
    std::string mode = "--echo";
    std::string number = std::to_string(domain);
    char* argv[] = {self.data(), mode.data(), number.data(), security.data(), nullptr};
    if (::posix_spawn(&pid_, self.c_str(), nullptr, nullptr, argv, environ) != 0) {
      throw std::runtime_error("cannot start " + self);
    }
  }
  ~EchoProcess() {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  EchoProcess(const EchoProcess&) = delete;
  EchoProcess& operator=(const EchoProcess&) = delete;

 private:
  pid_t pid_ = -1;
};

// Certificates that are removed with the object.
class Keystore {
 public:
  Keystore()
      : folder_(std::filesystem::temp_directory_path() /
                ("dfr-round-trip-" + std::to_string(::getpid()))) {
    MakeAuthority(folder_);
    AddParticipant(folder_, "ask", Permission::kController);
    AddParticipant(folder_, "answer", Permission::kConsole);
  }
  ~Keystore() {
    std::error_code ignored;
    std::filesystem::remove_all(folder_, ignored);
  }
  Keystore(const Keystore&) = delete;
  Keystore& operator=(const Keystore&) = delete;
  [[nodiscard]] std::string enclave(const char* name) const { return folder_ / "enclaves" / name; }

 private:
  std::filesystem::path folder_;
};

// Argument: 1 for a secured network, 0 for an open network.
void BM_RoundTrip(benchmark::State& state) {
  static const Keystore kKeystore;
  const bool secured = state.range(0) != 0;
  // The two domains differ, and are above the domains of the tests.
  const int domain = secured ? 102 : 101;
  const EchoProcess echo(domain, secured ? kKeystore.enclave("answer") : "");
  Participant participant(Options(domain, secured ? kKeystore.enclave("ask") : ""));
  Publisher<PoseStamped> ask(participant, kAsk, Role::kCommand);
  Subscriber<PoseStamped> answer(participant, kAnswer, Role::kCommand);
  PoseStamped pose;
  pose.frame_id = "PSM1_base";
  const auto end = Clock::now() + std::chrono::duration<double>(kPatience_s);
  bool found = false;
  while (!found && Clock::now() < end) {
    ask.Write(pose);
    found = answer.Wait(0.1);
  }
  if (!found) return state.SkipWithError("the other process does not answer");
  while (answer.Wait(0.2)) answer.Take(pose);  // discards answers in transit

  std::vector<double> times_s;
  double number = 0.0;
  for (auto _ : state) {
    pose.position_m.x() = ++number;
    const auto start = Clock::now();
    ask.Write(pose);
    PoseStamped back;
    while (back.position_m.x() != number) {
      if (!answer.Wait(1.0)) return state.SkipWithError("a command was lost");
      answer.Take(back);
    }
    times_s.push_back(std::chrono::duration<double>(Clock::now() - start).count());
    state.SetIterationTime(times_s.back());
  }
  state.counters["p50_us"] = 1e6 * core::Quantile(times_s, 0.5);
  state.counters["p99_us"] = 1e6 * core::Quantile(times_s, 0.99);
}
BENCHMARK(BM_RoundTrip)
    ->ArgName("secured")
    ->Arg(0)
    ->Arg(1)
    ->UseManualTime()
    ->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace dfr::dds

int main(int argc, char** argv) {
  if (argc == 4 && std::string_view(argv[1]) == "--echo") {
    return dfr::dds::Echo(std::atoi(argv[2]), argv[3]);
  }
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return EXIT_FAILURE;
  benchmark::RunSpecifiedBenchmarks();
  return EXIT_SUCCESS;
}
