// Passes of the network compared with the same formulas in plain Eigen, and complete fits. The
// network has the Pusher's sizes: 12 inputs, 7 controls. `batch` is the number of samples. Rates
// are per sample.

#include <benchmark/benchmark.h>

#include <Eigen/Core>
#include <span>
#include <utility>
#include <vector>

#include "bench/imitation/eigen_mlp.h"
#include "dfr/core/random.h"
#include "dfr/imitation/fit_mlp.h"
#include "dfr/imitation/mlp.h"

namespace dfr::imitation {
namespace {

using core::Matrix;

constexpr int kInputs = 12;
constexpr int kOutputs = 7;

Matrix RandomMatrix(Eigen::Index rows, Eigen::Index cols, std::uint64_t seed) {
  core::Random random(seed);
  Matrix m(rows, cols);
  for (Eigen::Index i = 0; i < m.size(); ++i) m.data()[i] = random.Normal();
  return m;
}

Mlp Network(int width) {
  core::Random random(1);
  return {{kInputs, width, width, kOutputs}, random};
}

std::vector<bench::EigenMlp::Layer> Layers(const Mlp& mlp) {
  std::vector<bench::EigenMlp::Layer> layers;
  for (const Mlp::Layer& layer : mlp.layers()) {
    const double* parameters = mlp.parameters().data();
    layers.push_back(
        {layer.inputs, layer.outputs, parameters + layer.weights, parameters + layer.biases});
  }
  return layers;
}

// Both networks, and inputs that change between calls and fit into the second-level cache.
struct Case {
  Mlp mlp;
  bench::EigenMlp eigen;
  std::vector<Matrix> inputs;
  Matrix output_gradient;
  Mlp::Workspace workspace;
  Eigen::VectorXd gradient;

  explicit Case(const benchmark::State& state)
      : mlp(Network(static_cast<int>(state.range(0)))),
        eigen(Layers(mlp)),
        output_gradient(RandomMatrix(state.range(1), kOutputs, 2)) {
    for (std::uint64_t i = 0; i < 4; ++i) {
      inputs.push_back(RandomMatrix(state.range(1), kInputs, 3 + i));
    }
  }

  // Compares both networks. The tolerance allows for sums of `batch` terms of size 1.
  bool RightAnswers() {
    const double tolerance = 1e-12 * static_cast<double>(output_gradient.rows());
    const Eigen::Map<const Matrix> outputs(EigenForward(0), inputs[0].rows(), kOutputs);
    if (!outputs.isApprox(mlp.Forward(inputs[0], workspace), 1e-12)) return false;
    EigenBackward(0);
    mlp.Backward(inputs[0], output_gradient, workspace, gradient);
    std::vector<double> one(kOutputs);
    mlp.Forward(core::Row(inputs[0], 0), one);
    const std::vector<double> expected = eigen.gradient();
    return (gradient - core::AsVector(expected)).cwiseAbs().maxCoeff() < tolerance &&
           core::AsVector(std::span<const double>(one)).isApprox(outputs.row(0).transpose(), 1e-12);
  }

  const double* EigenForward(std::size_t i) {
    return eigen.Forward(Inputs(i).data(), static_cast<int>(Inputs(i).rows()));
  }
  void EigenBackward(std::size_t i) {
    eigen.Backward(Inputs(i).data(), output_gradient.data(), static_cast<int>(Inputs(i).rows()));
  }

  const Matrix& Inputs(std::size_t i) const { return inputs[i % inputs.size()]; }
};

void CountSamples(benchmark::State& state) {
  state.SetItemsProcessed(state.iterations() * state.range(1));
}

void BM_Forward(benchmark::State& state) {
  Case c(state);
  if (!c.RightAnswers()) return state.SkipWithError("wrong answer");
  std::size_t i = 0;
  for (auto _ : state) benchmark::DoNotOptimize(c.mlp.Forward(c.Inputs(i++), c.workspace).data());
  CountSamples(state);
}

void BM_ForwardEigen(benchmark::State& state) {
  Case c(state);
  if (!c.RightAnswers()) return state.SkipWithError("wrong answer");
  std::size_t i = 0;
  for (auto _ : state) benchmark::DoNotOptimize(c.EigenForward(i++));
  CountSamples(state);
}

void BM_ForwardBackward(benchmark::State& state) {
  Case c(state);
  if (!c.RightAnswers()) return state.SkipWithError("wrong answer");
  std::size_t i = 0;
  for (auto _ : state) {
    const Matrix& inputs = c.Inputs(i++);
    c.mlp.Forward(inputs, c.workspace);
    c.mlp.Backward(inputs, c.output_gradient, c.workspace, c.gradient);
    benchmark::DoNotOptimize(c.gradient.data());
  }
  CountSamples(state);
}

void BM_ForwardBackwardEigen(benchmark::State& state) {
  Case c(state);
  if (!c.RightAnswers()) return state.SkipWithError("wrong answer");
  std::size_t i = 0;
  for (auto _ : state) {
    c.EigenForward(i);
    c.EigenBackward(i++);
    benchmark::ClobberMemory();
  }
  CountSamples(state);
}

// One state without a workspace, as in a control loop.
void BM_ForwardOne(benchmark::State& state) {
  Case c(state);
  if (!c.RightAnswers()) return state.SkipWithError("wrong answer");
  std::vector<double> u(kOutputs);
  Eigen::Index i = 0;
  for (auto _ : state) {
    c.mlp.Forward(core::Row(c.inputs[0], i++ % c.inputs[0].rows()), u);
    benchmark::DoNotOptimize(u.data());
  }
}

void BM_ForwardOneEigen(benchmark::State& state) {
  Case c(state);
  if (!c.RightAnswers()) return state.SkipWithError("wrong answer");
  Eigen::Index i = 0;
  for (auto _ : state) {
    const std::span<const double> x =
        core::Row(std::as_const(c.inputs[0]), i++ % c.inputs[0].rows());
    benchmark::DoNotOptimize(c.eigen.Forward(x.data(), 1));
  }
}

// 120 demonstrations of 60 steps, 10 epochs of Adam.
void BM_FitMlpAdam(benchmark::State& state) {
  core::StateLayout layout;
  layout.Add("state", kInputs);
  const Matrix states = RandomMatrix(7200, kInputs, 7);
  Mlp::Workspace workspace;
  const Matrix controls = Network(8).Forward(states, workspace);
  const int width = static_cast<int>(state.range(0));
  FitMlpOptions options;
  options.hidden = state.range(1) == 1 ? std::vector<int>{width} : std::vector<int>{width, width};
  for (auto _ : state) {
    FitReport report;
    FitMlp(layout, states, controls, options, &report);
    if (!(report.final_loss < 0.5 * report.initial_loss)) {
      return state.SkipWithError("wrong answer");
    }
  }
}

BENCHMARK(BM_Forward)
    ->ArgNames({"width", "batch"})
    ->Args({8, 1024})
    ->Args({64, 64})
    ->Args({64, 4096});
BENCHMARK(BM_ForwardEigen)
    ->ArgNames({"width", "batch"})
    ->Args({8, 1024})
    ->Args({64, 64})
    ->Args({64, 4096});
BENCHMARK(BM_ForwardBackward)
    ->ArgNames({"width", "batch"})
    ->Args({8, 1024})
    ->Args({64, 64})
    ->Args({64, 4096});
BENCHMARK(BM_ForwardBackwardEigen)
    ->ArgNames({"width", "batch"})
    ->Args({8, 1024})
    ->Args({64, 64})
    ->Args({64, 4096});
BENCHMARK(BM_ForwardOne)->ArgNames({"width", "states"})->Args({8, 64})->Args({64, 64});
BENCHMARK(BM_ForwardOneEigen)->ArgNames({"width", "states"})->Args({8, 64})->Args({64, 64});
BENCHMARK(BM_FitMlpAdam)
    ->ArgNames({"width", "layers"})
    ->Args({8, 1})
    ->Args({64, 2})
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace dfr::imitation

BENCHMARK_MAIN();
