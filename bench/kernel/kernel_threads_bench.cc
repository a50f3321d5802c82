// Scaling of fits, fits per time step and batches of decisions with threads: wall time with one
// thread and with one thread per core, and a bitwise comparison of the results. Meaningful only on
// an idle machine.
//
//   kernel_threads_bench [--threads=N] [--filter=TEXT] [--rounds=N]
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "bench/cpu_seconds.h"
#include "bench/kernel/contest.h"
#include "bench/kernel/trajectories.h"
#include "dfr/core/text/format.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/time_varying_support.h"

namespace dfr::bench {
namespace {

constexpr double kNu = 0.05;
constexpr double kTolerance = 1e-3;

struct Options {
  int threads = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  int rounds = 3;
  bool smoke = false;
  std::string filter;

  static Options Parse(int argc, char** argv) {
    Options o;
    for (int i = 1; i < argc; ++i) {
      const std::string argument = argv[i];
      const auto number = [&](const char* key, int& value) {
        if (!argument.starts_with(key)) return false;
        value = std::atoi(argument.c_str() + std::char_traits<char>::length(key));
        return value >= 1;
      };
      if (number("--threads=", o.threads) || number("--rounds=", o.rounds)) continue;
      if (argument.starts_with("--filter=")) {
        o.filter = argument.substr(9);
      } else if (argument.starts_with("--benchmark_min_time=")) {
        o.smoke = true;
        o.rounds = 1;
      } else {
        throw std::invalid_argument("invalid argument '" + argument +
                                    "'; valid: --threads=N (1 or more) --filter=TEXT --rounds=N");
      }
    }
    return o;
  }
};

// Results, for bitwise comparison.
using Bits = std::vector<double>;
// Does the work on the given number of threads.
using Job = std::function<Bits(int)>;

struct Times {
  double wall = std::numeric_limits<double>::infinity();
  double cpu = std::numeric_limits<double>::infinity();
};

class Runner {
 public:
  explicit Runner(Options options) : options_(std::move(options)) {}

  // Alternates between one thread and all threads, and uses the minimum over the rounds.
  void Run(const std::string& name, const Job& job) {
    if (name.find(options_.filter) == std::string::npos) return;
    Times times[2];
    Bits bits[2];
    for (int round = 0; round < options_.rounds; ++round) {
      for (const int which : {0, 1}) {
        const auto start = std::chrono::steady_clock::now();
        const double cpu = CpuSeconds();
        bits[which] = job(which == 0 ? 1 : options_.threads);
        times[which].cpu = std::min(times[which].cpu, CpuSeconds() - cpu);
        times[which].wall = std::min(
            times[which].wall,
            std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());
      }
    }
    const bool equal = bits[0] == bits[1];
    right_ &= equal;
    std::printf("%-40s %10.2f ms %10.2f ms %8.2fx %12.2fx  %s\n", name.c_str(), 1e3 * times[0].wall,
                1e3 * times[1].wall, times[0].wall / times[1].wall, times[1].cpu / times[0].cpu,
                equal ? "equal" : "DIFFERENT");
    std::fflush(stdout);
  }

  void Fit(int n, int d, double gamma, bool drifting) {
    if (options_.smoke) n /= 20;
    const std::string name =
        core::Format("fit %s %d x %d, gamma %.3g", drifting ? "drifting" : "pooled", n, d, gamma);
    if (name.find(options_.filter) == std::string::npos) return;
    const core::Matrix samples =
        drifting ? DriftingTrajectories(n, d, 8) : PooledTrajectories(n, d, 3);
    Run(name, [&](int threads) {
      kernel::FitSummary summary;
      const auto svm = kernel::OneClassSvm::Fit(
          samples, {.nu = kNu, .gamma = gamma, .tolerance = kTolerance, .threads = threads},
          &summary);
      Bits bits(summary.alpha.begin(), summary.alpha.end());
      bits.push_back(svm.rho());
      return bits;
    });
  }

  void TimeSteps(int demonstrations, int steps) {
    const core::Matrix states = 0.3 * PooledTrajectories(demonstrations * steps, 12, 4);
    std::vector<core::Matrix> tracks;
    tracks.reserve(static_cast<std::size_t>(demonstrations));
    for (int i = 0; i < demonstrations; ++i)
      tracks.emplace_back(states.middleRows(i * steps, steps));
    Run(core::Format("%d time steps of %d", steps, demonstrations), [&](int threads) {
      const auto support = kernel::TimeVaryingSupport::Fit(
          tracks, {.svm = {.nu = kNu, .gamma = 5.0, .tolerance = kTolerance}, .threads = threads});
      Bits bits;
      for (int t = 0; t < support.num_steps(); ++t) {
        bits.insert(bits.end(), support.at(t).alpha().begin(), support.at(t).alpha().end());
        bits.push_back(support.at(t).rho());
      }
      return bits;
    });
  }

  void Batch(int queries) {
    if (options_.smoke) queries /= 20;
    const auto svm = kernel::OneClassSvm::Fit(
        PooledTrajectories(12000, 9, 3), {.nu = kNu, .gamma = 1.0 / 9.0, .tolerance = kTolerance});
    const core::Matrix x = PooledTrajectories(queries, 9, 5);
    Run(core::Format("%d decisions of %d support vectors", queries, svm.num_support_vectors()),
        [&](int threads) {
          Bits g(static_cast<std::size_t>(x.rows()));
          svm.DecisionBatch(x, g, threads);
          return g;
        });
  }

  [[nodiscard]] bool right() const { return right_; }

 private:
  Options options_;
  bool right_ = true;
};

}  // namespace
}  // namespace dfr::bench

int main(int argc, char** argv) try {
  using namespace dfr::bench;
  const Options options = Options::Parse(argc, argv);
  std::printf("%-40s %13s %10d thr. %9s %13s  bits\n", "wall time", "1 thread", options.threads,
              "faster", "CPU time");
  Runner runner(options);
  runner.Fit(12000, 9, 1.0 / 9.0, false);
  runner.Fit(12000, 9, 5.0, true);
  runner.Fit(12000, 16, 5.0, true);
  runner.Fit(12000, 32, 5.0, true);
  runner.Fit(50000, 9, 1.0 / 9.0, false);
  runner.Fit(50000, 9, 5.0, true);
  runner.Fit(200000, 9, 1.0 / 9.0, false);
  runner.TimeSteps(120, 100);
  runner.Batch(200000);
  return runner.right() ? EXIT_SUCCESS : EXIT_FAILURE;
} catch (const std::invalid_argument& e) {
  std::fprintf(stderr, "kernel_threads_bench: %s\n", e.what());
  return 2;
} catch (const std::exception& e) {
  std::fprintf(stderr, "kernel_threads_bench: %s\n", e.what());
  return EXIT_FAILURE;
}
