// Time of one Next() of guided recovery and of certified recovery, with the sizes of a robot's
// task: 12 features, 7 control entries, 120 demonstrations, 60 time steps. The counters are
// percentiles of single calls in ns. Each call includes one clock reading.
//
// Guided: a new state every time. Deep: the learned control passes. Edge: states 0.6 to 2 times as
// far off the path as demonstrated states, where the control is filtered or a recovery runs. The
// budget is 20 000 ns (p99), with the support in single precision (Float), as for the Pusher.
//
// Certified: on a plant with the demonstrated dynamics, with a policy noisier than demonstrated and
// twice the eps estimated from demonstrations. The budget is 25 000 ns (p99).

#include <benchmark/benchmark.h>

#include <Eigen/QR>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "bench/control/linear_policy.h"
#include "bench/control/percentiles.h"
#include "dfr/control/certified/certificate_constants.h"
#include "dfr/control/certified/certified_controller.h"
#include "dfr/control/guided/guided_controller.h"
#include "dfr/control/guided/task_view.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/matrix.h"
#include "dfr/core/random.h"
#include "dfr/kernel/whitened_support.h"

namespace dfr::control {
namespace {

constexpr int kStateDim = 12;
constexpr int kControlDim = 7;
constexpr int kHorizon = 60;
constexpr int kDemonstrations = 120;

double Mean(int t, int k) { return std::sin(0.05 * t + k); }

// A mean path with a spread of 0.03. Controls move the first seven entries.
std::vector<core::Trajectory> Demonstrations() {
  core::Random random(1);
  std::vector<core::Trajectory> demonstrations;
  for (int i = 0; i < kDemonstrations; ++i) {
    core::Trajectory trajectory;
    trajectory.states.resize(kHorizon + 1, kStateDim);
    trajectory.controls.resize(kHorizon, kControlDim);
    for (int t = 0; t <= kHorizon; ++t) {
      for (int k = 0; k < kStateDim; ++k) {
        trajectory.states(t, k) = Mean(t, k) + 0.03 * random.Normal();
      }
    }
    for (int t = 0; t < kHorizon; ++t) {
      for (int k = 0; k < kControlDim; ++k) {
        trajectory.controls(t, k) = trajectory.states(t + 1, k) - trajectory.states(t, k);
      }
    }
    demonstrations.push_back(std::move(trajectory));
  }
  return demonstrations;
}

void Report(benchmark::State& state, std::vector<double>& nanoseconds, std::int64_t other) {
  bench::AddPercentiles(state, nanoseconds);
  state.counters["not_learned_%"] =
      100.0 * static_cast<double>(other) / static_cast<double>(nanoseconds.size());
}

void BM_Next(benchmark::State& state, double spread, bool single) {
  const auto demonstrations = Demonstrations();
  std::vector<core::Matrix> states;
  states.reserve(demonstrations.size());
  for (const auto& d : demonstrations) states.push_back(d.states);
  const auto features =
      core::FeatureTransform::Whitening(core::FeatureSelection::All(kStateDim), states);
  const FeatureTrajectories seen(features, demonstrations);
  const auto support = kernel::WhitenedSupport::Fit(seen.points, {.single_precision = single});
  const Levels levels(support, seen.points);
  const Response response(seen);
  const bench::LinearPolicy policy;
  GuidedOptions options;
  options.horizon = 1 << 30;
  options.max_controls = 1 << 30;
  GuidedController controller(policy, {features, support, levels, response}, options);

  core::Random random(2);
  core::Matrix queries(64 * kHorizon, kStateDim);
  for (Eigen::Index i = 0; i < queries.rows(); ++i) {
    const double size = spread * random.Uniform(0.3, 1.0);
    for (int k = 0; k < kStateDim; ++k) {
      queries(i, k) = Mean(static_cast<int>(i % kHorizon), k) + size * random.Normal();
    }
  }
  std::vector<double> u(kControlDim);
  std::vector<double> nanoseconds;
  nanoseconds.reserve(state.max_iterations);
  Eigen::Index query = 0;
  std::int64_t other = 0;
  while (state.KeepRunning()) {
    if (query % kHorizon == 0 || controller.halt_cause() != HaltCause::kNone) {
      controller.Reset(static_cast<std::uint64_t>(query));
    }
    const std::span<const double> x = core::Row(std::as_const(queries), query);
    const auto start = std::chrono::steady_clock::now();
    const Step step = controller.Next(x, u);
    nanoseconds.push_back(
        std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - start).count());
    other += step.mode != Mode::kPolicy || step.filtered ? 1 : 0;
    query = (query + 1) % queries.rows();
  }
  Report(state, nanoseconds, other);
  state.counters["support_vectors"] = support.estimate(kHorizon / 2).num_support_vectors();
}

// Controls move the state along seven of twelve directions. The components along the other five
// differ between episodes.
class Driven {
 public:
  Driven() {
    core::Random random(3);
    Eigen::MatrixXd entries(kStateDim, kStateDim);
    for (double& entry : entries.reshaped()) entry = random.Normal();
    basis_ = Eigen::HouseholderQR<Eigen::MatrixXd>(entries).householderQ();
  }
  [[nodiscard]] Eigen::VectorXd Start(core::Random& random) const {
    Eigen::VectorXd inner(kStateDim);
    for (int k = 0; k < kStateDim; ++k) {
      inner[k] = (k < kControlDim ? Mean(0, k) : 0.0) + 0.03 * random.Normal();
    }
    return basis_ * inner;
  }
  // Writes to `u` a control towards the path plus normal noise of standard deviation `size`.
  void Control(int t, std::span<const double> x, double size, core::Random& random,
               std::span<double> u) const {
    const Eigen::VectorXd inner = basis_.transpose() * core::AsVector(x);
    for (int k = 0; k < kControlDim; ++k) {
      u[static_cast<std::size_t>(k)] =
          Mean(t + 1, k) - Mean(t, k) - 0.3 * (inner[k] - Mean(t, k)) + size * random.Normal();
    }
  }
  // Applies the control with a random error of 3 % of its norm.
  void Apply(std::span<const double> u, core::Random& random, std::span<double> x) const {
    Eigen::VectorXd change = Eigen::VectorXd::Zero(kStateDim);
    change.head(kControlDim) = core::AsVector(u);
    const double astray = 0.03 * change.norm() / std::sqrt(kStateDim);
    for (double& entry : change) entry += astray * random.Normal();
    core::AsVector(x) += basis_ * change;
  }

 private:
  Eigen::MatrixXd basis_;
};

class Bold final : public core::Policy {
 public:
  Bold(const Driven& world, core::Random& random) : world_(&world), random_(&random) {}
  int state_dim() const noexcept override { return kStateDim; }
  int control_dim() const noexcept override { return kControlDim; }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override {
    world_->Control(t, x, 0.03, *random_, u);
  }

 private:
  const Driven* world_;
  core::Random* random_;
};

void BM_Certified(benchmark::State& state) {
  const Driven world;
  core::Random random(4);
  std::vector<core::Trajectory> demonstrations(kDemonstrations);
  std::vector<core::Matrix> states;
  states.reserve(demonstrations.size());
  for (core::Trajectory& d : demonstrations) {
    d.states.resize(kHorizon + 1, kStateDim);
    d.controls.resize(kHorizon, kControlDim);
    d.states.row(0) = world.Start(random);
    for (int t = 0; t < kHorizon; ++t) {
      world.Control(t, core::Row(d.states, t), 0.02, random, core::Row(d.controls, t));
      d.states.row(t + 1) = d.states.row(t);
      world.Apply(core::Row(d.controls, t), random, core::Row(d.states, t + 1));
    }
    states.push_back(d.states);
  }
  const auto features =
      core::FeatureTransform::Whitening(core::FeatureSelection::All(kStateDim), states);
  const FeatureTrajectories seen(features, demonstrations);
  const auto support = kernel::WhitenedSupport::Fit(seen.points);
  const Levels levels(support, seen.points);
  const Response response(seen);
  const Bold policy(world, random);
  CertifiedController controller(
      policy, {features, support, levels, response},
      {.horizon = kHorizon,
       .certificate = {2.0 * EstimateDirectionError(features, demonstrations).value}});
  Eigen::VectorXd x = world.Start(random);
  std::vector<double> u(kControlDim);
  std::vector<double> nanoseconds;
  nanoseconds.reserve(state.max_iterations);
  std::int64_t other = 0;
  while (state.KeepRunning()) {
    const auto start = std::chrono::steady_clock::now();
    const Step step = controller.Next(core::AsSpan(std::as_const(x)), u);
    nanoseconds.push_back(
        std::chrono::duration<double, std::nano>(std::chrono::steady_clock::now() - start).count());
    if (step.mode == Mode::kHalt) {
      x = world.Start(random);
      controller.Reset(1);
      continue;
    }
    other += step.mode != Mode::kPolicy || step.filtered ? 1 : 0;
    world.Apply(u, random, core::AsSpan(x));
  }
  Report(state, nanoseconds, other);
}

BENCHMARK_CAPTURE(BM_Next, Guided_Deep, 0.01, false);
BENCHMARK_CAPTURE(BM_Next, Guided_Deep_Float, 0.01, true);
BENCHMARK_CAPTURE(BM_Next, Guided_Edge, 0.06, false);
BENCHMARK_CAPTURE(BM_Next, Guided_Edge_Float, 0.06, true);
BENCHMARK(BM_Certified);

}  // namespace
}  // namespace dfr::control

BENCHMARK_MAIN();
