// Operations whose speed bench/compare.py compares: decisions, gradients, fits, a guided step, a
// guard's filter. Callgrind counts each operation separately and dumps the count by name. --time
// measures times instead.
//
//   counted_work [--filter=TEXT] [--time=SECONDS] [--slow=PERCENT] [--few]
//
// --few repeats each operation a fifth as often. Callgrind then takes a third of the time. --slow
// adds PERCENT more repetitions, a simulated slow-down that tests the comparison.
#include <valgrind/callgrind.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <functional>
#include <memory>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "bench/control/linear_policy.h"
#include "bench/cpu_seconds.h"
#include "bench/kernel/trajectories.h"
#include "dfr/control/guided/guided_controller.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/random.h"
#include "dfr/kernel/one_class_svm.h"
#include "dfr/kernel/time_varying_support.h"
#include "dfr/kernel/whitened_support.h"
#include "dfr/safety/guard.h"
#include "dfr/safety/guard_model.h"
#include "dfr/safety/task_model.h"

namespace {

using Operation = std::function<void(int)>;

// Keeps the compiler from removing computations.
volatile double sink = 0.0;

}  // namespace

namespace dfr::bench {
namespace {

struct Options {
  std::string filter;
  double seconds = 0.0;
  double slow = 0.0;
  bool few = false;
};

class Runner {
 public:
  explicit Runner(Options options) : options_(std::move(options)) {}

  // `make` returns the operation. Run() does not call it if the filter excludes the name.
  template <typename Make>
  void Run(const std::string& name, int operations, Make&& make) {
    if (name.find(options_.filter) == std::string::npos) return;
    const Operation operation = make();
    // Starts Callgrind's simulation only here, to save time.
    CALLGRIND_START_INSTRUMENTATION;
    operation(0);  // warm
    if (options_.few) operations /= 5;
    const int count = operations + static_cast<int>(operations * options_.slow / 100.0);
    const auto all = [&] {
      for (int i = 0; i < count; ++i) operation(i);
    };
    if (options_.seconds == 0.0) {
      CALLGRIND_ZERO_STATS;
      all();
      CALLGRIND_DUMP_STATS_AT(name.c_str());
      CALLGRIND_STOP_INSTRUMENTATION;
      return;
    }
    // The minimum of several intervals: other load on the machine only adds time.
    double least = 0.0;
    double spent = 0.0;
    while (spent < options_.seconds) {
      const double start = CpuSeconds();
      all();
      const double taken = CpuSeconds() - start;
      least = spent == 0.0 ? taken : std::min(least, taken);
      spent += taken;
    }
    std::printf("%s\t%.1f\n", name.c_str(), 1e9 * least / operations);
    std::fflush(stdout);
  }

 private:
  Options options_;
};

constexpr int kDim = 9;

// About half of the samples are support vectors.
kernel::OneClassSvm Estimate(int support_vectors) {
  return kernel::OneClassSvm::Fit(PooledTrajectories(2 * support_vectors, kDim, 1),
                                  {.nu = 0.47, .gamma = 1.0 / kDim, .tolerance = 1e-3});
}

void RunDecisions(Runner& runner) {
  const auto queries = std::make_shared<core::Matrix>(PooledTrajectories(256, kDim, 2));
  const auto query = [queries](int i) { return core::Row(std::as_const(*queries), i % 256); };
  for (const bool single : {false, true}) {
    const std::string precision = single ? ", float" : ", double";
    const auto estimate = [single](int size) {
      const auto svm = Estimate(size);
      return single ? svm.InSinglePrecision() : svm;
    };
    for (const int size : {64, 256, 600}) {
      runner.Run("decision of " + std::to_string(size) + precision, 200, [&]() -> Operation {
        return [svm = estimate(size), query](int i) { sink = svm.Decision(query(i)); };
      });
    }
    runner.Run("batch of 256 decisions of 600" + precision, 10, [&]() -> Operation {
      return [svm = estimate(600), queries, g = std::vector<double>(256)](int) mutable {
        svm.DecisionBatch(*queries, g);
        sink = g[0];
      };
    });
    runner.Run("gradient of 256" + precision, 100, [&]() -> Operation {
      return [svm = estimate(256), query, out = std::vector<double>(kDim)](int i) mutable {
        sink = svm.Gradient(query(i), out);
      };
    });
    // Certificates use this gradient.
    runner.Run("gradient of the logarithm of 256" + precision, 100, [&]() -> Operation {
      return [svm = estimate(256), query, out = std::vector<double>(kDim)](int i) mutable {
        sink = svm.LogGradient(query(i), out);
      };
    });
  }
}

void RunFits(Runner& runner) {
  // The largest fit runs only its first steps, including set-up and completion, because the
  // simulation is slow.
  struct Fit {
    const char* name;
    int n;
    double gamma;
    int most_steps;
    double tolerance = 1e-3;
  };
  for (const Fit& f : {Fit{"fit of 120", 120, 5.0, 0}, Fit{"whole fit of 700", 700, 5.0, 0},
                       Fit{"fit of 1200, narrow kernel", 1200, 50.0, 30, 1e-7}}) {
    runner.Run(f.name, 10, [&]() -> Operation {
      return [f, samples = PooledTrajectories(f.n, kDim, 3)](int) {
        sink = kernel::OneClassSvm::Fit(
                   samples,
                   {.gamma = f.gamma, .tolerance = f.tolerance, .max_iterations = f.most_steps})
                   .rho();
      };
    });
  }
}

// Demonstrations that follow a mean path with a spread of 0.03; controls move the first entries.
std::vector<core::Trajectory> Demonstrations(int count, int steps, int states, int controls) {
  core::Random random(1);
  std::vector<core::Trajectory> demonstrations(static_cast<std::size_t>(count));
  for (core::Trajectory& d : demonstrations) {
    d.states.resize(steps + 1, states);
    for (int t = 0; t <= steps; ++t) {
      for (int k = 0; k < states; ++k) {
        d.states(t, k) = std::sin(0.05 * t + k) + 0.03 * random.Normal();
      }
    }
    d.controls = (d.states.bottomRows(steps) - d.states.topRows(steps)).leftCols(controls);
    d.outcome = core::Outcome::kCompleted;
  }
  return demonstrations;
}

void RunControllers(Runner& runner) {
  constexpr int kSteps = 20;
  constexpr int kEpisode = 12;  // steps of one operation
  const auto demonstrations = Demonstrations(24, kSteps, 12, 7);
  // States near the demonstrated states and at the edge of the support.
  core::Random random(2);
  core::Matrix queries(kSteps, 12);
  for (int t = 0; t < kSteps; ++t) {
    for (int k = 0; k < 12; ++k) {
      queries(t, k) = std::sin(0.05 * t + k) + (t % 2 == 0 ? 0.01 : 0.04) * random.Normal();
    }
  }
  runner.Run("guided step", 10, [&]() -> Operation {
    core::StateLayout layout;
    layout.Add("x", 12);
    struct Guided {
      LinearPolicy policy;
      safety::TaskModel task;
      control::GuidedController controller;
      Guided(const core::StateLayout& layout, const std::vector<core::Trajectory>& demonstrations)
          : task(layout, demonstrations, {.guided = {.single_precision = true}}),
            controller(policy, task.view()) {}
    };
    const auto guided = std::make_shared<Guided>(layout, demonstrations);
    return [guided, &queries, u = std::vector<double>(7)](int) mutable {
      guided->controller.Reset(1);
      for (int t = 0; t < kEpisode; ++t) {
        (void)guided->controller.Next(core::Row(std::as_const(queries), t), u);
      }
      sink = u[0];
    };
  });
  runner.Run("Guard::Filter", 10, [&]() -> Operation {
    core::StateLayout layout;
    layout.Add("x", 12);
    const auto guard =
        std::make_shared<safety::Guard>(safety::GuardModel::Fit(layout, demonstrations));
    return [guard, &queries, u = std::vector<double>(7, 0.05),
            safe = std::vector<double>(7)](int) mutable {
      guard->Reset(1);
      for (int t = 0; t < kEpisode; ++t) {
        (void)guard->Filter(t, core::Row(std::as_const(queries), t), u, safe);
      }
      sink = safe[0];
    };
  });
}

Options Parse(int argc, char** argv) {
  Options options;
  for (int i = 1; i < argc; ++i) {
    const std::string_view argument = argv[i];
    const auto value = [&](std::string_view key) {
      return argument.starts_with(key) ? argv[i] + key.size() : nullptr;
    };
    if (const char* text = value("--filter=")) {
      options.filter = text;
    } else if (const char* seconds = value("--time=")) {
      options.seconds = std::strtod(seconds, nullptr);
    } else if (const char* percent = value("--slow=")) {
      options.slow = std::strtod(percent, nullptr);
    } else if (argument == "--few") {
      options.few = true;
    } else {
      throw std::invalid_argument("invalid argument '" + std::string(argument) +
                                  "'; valid: --filter=TEXT --time=SECONDS --slow=PERCENT --few");
    }
  }
  return options;
}

}  // namespace
}  // namespace dfr::bench

int main(int argc, char** argv) try {
  dfr::bench::Runner runner(dfr::bench::Parse(argc, argv));
  dfr::bench::RunDecisions(runner);
  dfr::bench::RunFits(runner);
  dfr::bench::RunControllers(runner);
  return EXIT_SUCCESS;
} catch (const std::invalid_argument& e) {
  std::fprintf(stderr, "counted_work: %s\n", e.what());
  return 2;
} catch (const std::exception& e) {
  std::fprintf(stderr, "counted_work: %s\n", e.what());
  return EXIT_FAILURE;
}
