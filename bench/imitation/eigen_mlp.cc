#include "bench/imitation/eigen_mlp.h"

#include <Eigen/Core>

namespace dfr::bench {
namespace {

using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Given = Eigen::Map<const Matrix>;

}  // namespace

struct EigenMlp::Network {
  std::vector<Matrix> weights;
  std::vector<Eigen::RowVectorXd> biases;
  std::vector<Matrix> activations;
  std::vector<Matrix> gradients;
  std::vector<Eigen::RowVectorXd> bias_gradients;
  Matrix delta;
  Matrix next;

  template <typename From>
  void ForwardLayer(std::size_t l, const From& from) {
    activations[l].noalias() = from * weights[l];
    activations[l].rowwise() += biases[l];
    if (l + 1 < weights.size()) activations[l] = activations[l].array().tanh();
  }
};

EigenMlp::EigenMlp(std::span<const Layer> layers) : network_(std::make_unique<Network>()) {
  for (const Layer& layer : layers) {
    network_->weights.emplace_back(Given(layer.weights, layer.inputs, layer.outputs));
    network_->biases.emplace_back(
        Eigen::Map<const Eigen::RowVectorXd>(layer.biases, layer.outputs));
  }
  network_->activations.resize(layers.size());
  network_->gradients.resize(layers.size());
  network_->bias_gradients.resize(layers.size());
}

EigenMlp::~EigenMlp() = default;

const double* EigenMlp::Forward(const double* inputs, int rows) {
  Network& n = *network_;
  n.ForwardLayer(0, Given(inputs, rows, n.weights[0].rows()));
  for (std::size_t l = 1; l < n.weights.size(); ++l) n.ForwardLayer(l, n.activations[l - 1]);
  return n.activations.back().data();
}

void EigenMlp::Backward(const double* inputs, const double* output_gradient, int rows) {
  Network& n = *network_;
  n.delta = Given(output_gradient, rows, n.weights.back().cols());
  for (std::size_t l = n.weights.size(); l-- > 1;) {
    const Matrix& from = n.activations[l - 1];
    n.gradients[l].noalias() = from.transpose() * n.delta;
    n.bias_gradients[l] = n.delta.colwise().sum();
    n.next.noalias() = n.delta * n.weights[l].transpose();
    n.next.array() *= 1.0 - from.array().square();
    n.delta.swap(n.next);
  }
  n.gradients[0].noalias() = Given(inputs, rows, n.weights[0].rows()).transpose() * n.delta;
  n.bias_gradients[0] = n.delta.colwise().sum();
}

std::vector<double> EigenMlp::gradient() const {
  std::vector<double> flat;
  for (std::size_t l = 0; l < network_->weights.size(); ++l) {
    const Matrix& weights = network_->gradients[l];
    const Eigen::RowVectorXd& biases = network_->bias_gradients[l];
    flat.insert(flat.end(), weights.data(), weights.data() + weights.size());
    flat.insert(flat.end(), biases.data(), biases.data() + biases.size());
  }
  return flat;
}

}  // namespace dfr::bench
