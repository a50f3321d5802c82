// Passes of the network compared with the same formulas in plain Eigen, and complete fits. The
// network has the Pusher's sizes: 12 inputs, 7 controls. `batch` is the number of samples. Rates
// are per sample.

#include <benchmark/benchmark.h>

#include <Eigen/Core>
#include <vector>

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

// The same network in idiomatic Eigen.
class EigenMlp {
 public:
  explicit EigenMlp(const Mlp& mlp) {
    for (const Mlp::Layer& layer : mlp.layers()) {
      weights_.push_back(Eigen::Map<const Matrix>(mlp.parameters().data() + layer.weights,
                                                  layer.inputs, layer.outputs));
      biases_.push_back(mlp.parameters().segment(layer.biases, layer.outputs).transpose());
    }
    activations_.resize(weights_.size());
    gradients_.resize(weights_.size());
    bias_gradients_.resize(weights_.size());
  }

  const Matrix& Forward(const Matrix& inputs) {
    const Matrix* from = &inputs;
    for (std::size_t l = 0; l < weights_.size(); ++l) {
      activations_[l].noalias() = *from * weights_[l];
      activations_[l].rowwise() += biases_[l];
      if (l + 1 < weights_.size()) activations_[l] = activations_[l].array().tanh();
      from = &activations_[l];
    }
    return activations_.back();
  }

  void Backward(const Matrix& inputs, const Matrix& output_gradient) {
    delta_ = output_gradient;
    for (std::size_t l = weights_.size(); l-- > 0;) {
      const Matrix& from = l == 0 ? inputs : activations_[l - 1];
      gradients_[l].noalias() = from.transpose() * delta_;
      bias_gradients_[l] = delta_.colwise().sum();
      if (l == 0) break;
      next_.noalias() = delta_ * weights_[l].transpose();
      next_.array() *= 1.0 - from.array().square();
      delta_.swap(next_);
    }
  }

  Eigen::VectorXd gradient() const {
    std::vector<double> flat;
    for (std::size_t l = 0; l < weights_.size(); ++l) {
      flat.insert(flat.end(), gradients_[l].data(), gradients_[l].data() + gradients_[l].size());
      flat.insert(flat.end(), bias_gradients_[l].data(),
                  bias_gradients_[l].data() + bias_gradients_[l].size());
    }
    return core::AsVector(std::span<const double>(flat));
  }

 private:
  std::vector<Matrix> weights_;
  std::vector<Eigen::RowVectorXd> biases_;
  std::vector<Matrix> activations_;
  std::vector<Matrix> gradients_;
  std::vector<Eigen::RowVectorXd> bias_gradients_;
  Matrix delta_;
  Matrix next_;
};

// Both networks, and inputs that change between calls and fit into the second-level cache.
struct Case {
  Mlp mlp;
  EigenMlp eigen;
  std::vector<Matrix> inputs;
  Matrix output_gradient;
  Mlp::Workspace workspace;
  Eigen::VectorXd gradient;

  explicit Case(const benchmark::State& state)
      : mlp(Network(static_cast<int>(state.range(0)))),
        eigen(mlp),
        output_gradient(RandomMatrix(state.range(1), kOutputs, 2)) {
    for (std::uint64_t i = 0; i < 4; ++i) {
      inputs.push_back(RandomMatrix(state.range(1), kInputs, 3 + i));
    }
  }

  // Compares both networks. The tolerance allows for sums of `batch` terms of size 1.
  bool RightAnswers() {
    const double tolerance = 1e-12 * static_cast<double>(output_gradient.rows());
    if (!eigen.Forward(inputs[0]).isApprox(mlp.Forward(inputs[0], workspace), 1e-12)) return false;
    eigen.Backward(inputs[0], output_gradient);
    mlp.Backward(inputs[0], output_gradient, workspace, gradient);
    std::vector<double> one(kOutputs);
    mlp.Forward(core::Row(inputs[0], 0), one);
    return (gradient - eigen.gradient()).cwiseAbs().maxCoeff() < tolerance &&
           core::AsVector(std::span<const double>(one))
               .isApprox(eigen.Forward(inputs[0]).row(0).transpose(), 1e-12);
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
  for (auto _ : state) benchmark::DoNotOptimize(c.eigen.Forward(c.Inputs(i++)).data());
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
    const Matrix& inputs = c.Inputs(i++);
    c.eigen.Forward(inputs);
    c.eigen.Backward(inputs, c.output_gradient);
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
  Matrix x(1, kInputs);
  Eigen::Index i = 0;
  for (auto _ : state) {
    x = c.inputs[0].row(i++ % c.inputs[0].rows());
    benchmark::DoNotOptimize(c.eigen.Forward(x).data());
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
