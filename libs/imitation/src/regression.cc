#include "regression.h"

#include <algorithm>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

namespace dfr::imitation::internal {

RegressionLoss::RegressionLoss(Mlp mlp, double weight_decay)
    : mlp_(std::move(mlp)), weight_decay_(weight_decay) {}

double RegressionLoss::Evaluate(const Eigen::Ref<const Eigen::VectorXd>& parameters,
                                const Rows& inputs, const Rows& targets,
                                Eigen::VectorXd* gradient) {
  mlp_.SetParameters(parameters);
  const auto n = static_cast<double>(inputs.rows());
  if (error_.rows() < inputs.rows()) error_.resize(inputs.rows(), targets.cols());
  auto error = error_.topRows(inputs.rows());
  error = mlp_.Forward(inputs, workspace_) - targets;
  double loss = 0.5 * error.squaredNorm() / n;
  if (gradient != nullptr) {
    error /= n;
    mlp_.Backward(inputs, error, workspace_, *gradient);
  }
  if (weight_decay_ > 0.0) {
    for (const Mlp::Layer& layer : mlp_.layers()) {
      const auto weights = parameters.segment(layer.weights, layer.biases - layer.weights);
      loss += 0.5 * weight_decay_ * weights.squaredNorm();
      if (gradient != nullptr) {
        gradient->segment(layer.weights, weights.size()) += weight_decay_ * weights;
      }
    }
  }
  return loss;
}

void FitByAdam(const core::Matrix& inputs, const core::Matrix& targets, int epochs, int batch,
               double weight_decay, Adam& adam, core::Random& random, Mlp& mlp) {
  const Eigen::Index n = inputs.rows();
  const Eigen::Index most = std::min<Eigen::Index>(batch, n);
  std::vector<Eigen::Index> order(static_cast<std::size_t>(n));
  std::iota(order.begin(), order.end(), 0);
  core::Matrix batch_inputs(most, inputs.cols());
  core::Matrix batch_targets(most, targets.cols());
  RegressionLoss loss(mlp, weight_decay);
  Eigen::VectorXd gradient;
  Eigen::VectorXd parameters = mlp.parameters();
  for (int epoch = 0; epoch < epochs; ++epoch) {
    random.Shuffle(std::span(order));
    for (Eigen::Index first = 0; first < n; first += most) {
      const Eigen::Index rows = std::min(most, n - first);
      for (Eigen::Index i = 0; i < rows; ++i) {
        const Eigen::Index from = order[static_cast<std::size_t>(first + i)];
        batch_inputs.row(i) = inputs.row(from);
        batch_targets.row(i) = targets.row(from);
      }
      loss.Evaluate(parameters, batch_inputs.topRows(rows), batch_targets.topRows(rows), &gradient);
      adam.Step(gradient, parameters);
    }
  }
  mlp.SetParameters(parameters);
}

}  // namespace dfr::imitation::internal
