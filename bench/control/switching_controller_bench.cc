// Time of one Next() of each strategy, with the sizes of a robot's task: a new state every time, 12
// state entries, 7 control entries, 120 demonstrations, 60 time steps. The counters are percentiles
// of single calls in ns. Each call includes one clock reading, which BM_Clock measures separately.
// Open: calls that pass the learned control. Shut: calls of a recovery.

#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "bench/control/linear_policy.h"
#include "bench/control/percentiles.h"
#include "dfr/control/published/switching_controller.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#if DFR_BENCH_HAS_KERNEL
#include "dfr/kernel/time_varying_support.h"
#endif

namespace dfr::control {
namespace {

constexpr int kStateDim = 12;
constexpr int kControlDim = 7;
constexpr int kHorizon = 60;

// g_t(x) = exp(-|x - mean_t|^2) - 0.5
class Bump final : public core::DecisionFunction {
 public:
  int state_dim() const noexcept override { return kStateDim; }
  int num_steps() const noexcept override { return kHorizon; }
  double Decision(int t, std::span<const double> x) const noexcept override {
    double square = 0.0;
    for (int k = 0; k < kStateDim; ++k) {
      const double d = x[static_cast<std::size_t>(k)] - std::sin(0.05 * t + k);
      square += d * d;
    }
    return std::exp(-square) - 0.5;
  }
  double Gradient(int t, std::span<const double> x, std::span<double> g) const noexcept override {
    std::fill(g.begin(), g.end(), 0.0);
    return Decision(t, x);
  }
};

#if DFR_BENCH_HAS_KERNEL
// 120 demonstrations: a mean path with the spread of the Pusher's demonstrations, 0.03 m.
std::vector<core::Matrix> Demonstrations() {
  core::Random random(1);
  std::vector<core::Matrix> demonstrations;
  for (int i = 0; i < 120; ++i) {
    core::Matrix states(kHorizon + 1, kStateDim);
    for (int t = 0; t <= kHorizon; ++t) {
      for (int k = 0; k < kStateDim; ++k) {
        states(t, k) = std::sin(0.05 * t + k) + 0.03 * random.Normal();
      }
    }
    demonstrations.push_back(std::move(states));
  }
  return demonstrations;
}
#endif

std::unique_ptr<core::DecisionFunction> MakeSupport(bool kernel) {
#if DFR_BENCH_HAS_KERNEL
  if (kernel) {
    const auto demonstrations = Demonstrations();
    return std::make_unique<kernel::TimeVaryingSupport>(
        kernel::TimeVaryingSupport::Fit(demonstrations, {.svm = {.nu = 0.05, .gamma = 5.0}}));
  }
#endif
  return kernel ? nullptr : std::make_unique<Bump>();
}

using Clock = std::chrono::steady_clock;

void BM_Clock(benchmark::State& state) {
  std::vector<double> nanoseconds;
  nanoseconds.reserve(state.max_iterations);
  for (auto _ : state) {
    const auto start = Clock::now();
    nanoseconds.push_back(std::chrono::duration<double, std::nano>(Clock::now() - start).count());
  }
  bench::AddPercentiles(state, nanoseconds);
}

void BM_Next(benchmark::State& state, Recovery recovery, bool kernel, bool open) {
  const auto support = MakeSupport(kernel);
  const bench::LinearPolicy policy;
  // A tiny lambda opens the gate at any g > 0, and a huge lambda shuts it.
  const std::vector<double> lambda = {open ? 1e-9 : 1e9};
  const SwitchingControllerOptions options{
      .recovery = recovery, .horizon = kHorizon, .max_iterations = 1 << 30};
  SwitchingController controller(policy, *support, lambda, options);
  core::Random random(2);
  core::Matrix queries(1024 * kHorizon, kStateDim);
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    const auto t = static_cast<double>(open ? i % kHorizon : 0);
    for (int k = 0; k < kStateDim; ++k) {
      queries(i, k) = std::sin(0.05 * t + k) + 0.01 * random.Normal();
    }
  }
  std::vector<double> u(kControlDim);
  std::vector<double> nanoseconds;
  nanoseconds.reserve(state.max_iterations);
  Eigen::Index query = 0;
  bool wrong = false;
  for (auto _ : state) {
    if (query % kHorizon == 0 && open) controller.Reset(static_cast<std::uint64_t>(query));
    if (query == 0 && !open) controller.Reset(1);
    const std::span<const double> x = core::Row(std::as_const(queries), query);
    const auto start = Clock::now();
    const Step step = controller.Next(x, u);
    nanoseconds.push_back(std::chrono::duration<double, std::nano>(Clock::now() - start).count());
    wrong = wrong || (step.mode == Mode::kPolicy) != open || step.mode == Mode::kHalt;
    query = (query + 1) % queries.rows();
  }
  if (wrong) return state.SkipWithError("the controller left the mode to be measured");
  bench::AddPercentiles(state, nanoseconds);
}

#define DFR_BENCH_NEXT(kernel, support)                                                        \
  BENCHMARK_CAPTURE(BM_Next, Baseline_##support, Recovery::kNone, kernel, true);               \
  BENCHMARK_CAPTURE(BM_Next, EarlyStopping_##support##_Open, Recovery::kEarlyStopping, kernel, \
                    true);                                                                     \
  BENCHMARK_CAPTURE(BM_Next, Dfr_##support##_Open, Recovery::kDfr, kernel, true);              \
  BENCHMARK_CAPTURE(BM_Next, Dfr_##support##_Shut, Recovery::kDfr, kernel, false)

BENCHMARK(BM_Clock);
DFR_BENCH_NEXT(false, Analytic);
#if DFR_BENCH_HAS_KERNEL
DFR_BENCH_NEXT(true, Kernel);
#endif

}  // namespace
}  // namespace dfr::control

BENCHMARK_MAIN();
