#include "mlp/mlp_cost.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>

#include "checks.h"
#include "regression.h"

namespace dfr::imitation::internal {
namespace {

// Both methods stop if an iteration changes the loss by less than this fraction, or if the largest
// entry of the gradient is below the second value.
constexpr double kFunctionTolerance = 1e-9;
constexpr double kGradientTolerance = 1e-10;

class LossFunction final : public ceres::FirstOrderFunction {
 public:
  LossFunction(const core::Matrix& inputs, const core::Matrix& targets, double weight_decay,
               const Mlp& mlp)
      : inputs_(inputs), targets_(targets), size_(mlp.num_parameters()), loss_(mlp, weight_decay) {}

  bool Evaluate(const double* parameters, double* cost, double* gradient) const override {
    const Eigen::Map<const Eigen::VectorXd> theta(parameters, size_);
    if (!theta.allFinite()) return false;  // step too long; the search shortens it
    *cost = loss_.Evaluate(theta, inputs_, targets_, gradient == nullptr ? nullptr : &gradient_);
    if (gradient != nullptr) Eigen::Map<Eigen::VectorXd>(gradient, size_) = gradient_;
    return std::isfinite(*cost);
  }
  int NumParameters() const override { return static_cast<int>(size_); }

 private:
  const core::Matrix& inputs_;
  const core::Matrix& targets_;
  Eigen::Index size_;
  mutable RegressionLoss loss_;  // Ceres evaluates from one thread
  mutable Eigen::VectorXd gradient_;
};

// (mlp(x_i) - t_i) / sqrt(n) for a range of samples; the loss is half the squared norm.
class ErrorFunction final : public ceres::CostFunction {
 public:
  ErrorFunction(const core::Matrix& inputs, const core::Matrix& targets, Eigen::Index first,
                Eigen::Index count, Mlp& mlp)
      : inputs_(inputs.middleRows(first, count)),
        targets_(targets.middleRows(first, count)),
        scale_(1.0 / std::sqrt(static_cast<double>(inputs.rows()))),
        mlp_(mlp) {
    set_num_residuals(static_cast<int>(targets_.size()));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(mlp.num_parameters()));
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Map<const Eigen::VectorXd> theta(parameters[0], mlp_.num_parameters());
    if (!theta.allFinite()) return false;
    mlp_.SetParameters(theta);
    Eigen::Map<core::Matrix>(residuals, targets_.rows(), targets_.cols()) =
        scale_ * (mlp_.Forward(inputs_, workspace_) - targets_);
    if (jacobians != nullptr && jacobians[0] != nullptr) {
      Eigen::Map<core::Matrix> jacobian(jacobians[0], targets_.size(), mlp_.num_parameters());
      mlp_.Jacobian(inputs_, workspace_, jacobian);
      jacobian *= scale_;
    }
    return true;
  }

 private:
  core::Matrix inputs_;
  core::Matrix targets_;
  double scale_;
  Mlp& mlp_;  // scratch shared by all blocks: Ceres runs them in one thread
  mutable Mlp::Workspace workspace_;
};

Eigen::Index NumWeights(const Mlp& mlp) {
  Eigen::Index weights = 0;
  for (const Mlp::Layer& layer : mlp.layers()) weights += layer.biases - layer.weights;
  return weights;
}

// Residuals: sqrt(weight_decay) times each weight.
class DecayFunction final : public ceres::CostFunction {
 public:
  DecayFunction(double weight_decay, const Mlp& mlp)
      : factor_(std::sqrt(weight_decay)), layers_(mlp.layers()) {
    set_num_residuals(static_cast<int>(NumWeights(mlp)));
    mutable_parameter_block_sizes()->push_back(static_cast<int>(mlp.num_parameters()));
  }

  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Index size = parameter_block_sizes()[0];
    const bool with_jacobian = jacobians != nullptr && jacobians[0] != nullptr;
    if (with_jacobian) std::fill_n(jacobians[0], num_residuals() * size, 0.0);
    Eigen::Index row = 0;
    for (const Mlp::Layer& layer : layers_) {
      for (Eigen::Index i = layer.weights; i < layer.biases; ++i, ++row) {
        residuals[row] = factor_ * parameters[0][i];
        if (with_jacobian) jacobians[0][row * size + i] = factor_;
      }
    }
    return true;
  }

 private:
  double factor_;
  std::vector<Mlp::Layer> layers_;
};

}  // namespace

MinimizeSummary MinimizeByLbfgs(const core::Matrix& inputs, const core::Matrix& targets,
                                double weight_decay, int max_iterations, Mlp& mlp) {
  // The problem owns the function.
  const ceres::GradientProblem problem(new LossFunction(inputs, targets, weight_decay, mlp));
  ceres::GradientProblemSolver::Options options;
  options.line_search_direction_type = ceres::LBFGS;
  options.max_num_iterations = max_iterations;
  options.function_tolerance = kFunctionTolerance;
  options.gradient_tolerance = kGradientTolerance;
  options.logging_type = ceres::SILENT;
  ceres::GradientProblemSolver::Summary summary;
  Eigen::VectorXd parameters = mlp.parameters();
  ceres::Solve(options, problem, parameters.data(), &summary);
  mlp.SetParameters(parameters);
  return {std::max(0, static_cast<int>(summary.iterations.size()) - 1),
          summary.termination_type == ceres::CONVERGENCE, summary.message};
}

MinimizeSummary MinimizeByLevenbergMarquardt(const core::Matrix& inputs,
                                             const core::Matrix& targets, double weight_decay,
                                             int max_iterations, Mlp& mlp) {
  constexpr Eigen::Index kSamplesPerBlock = 256;
  ceres::Problem problem;
  Mlp scratch = mlp;
  Eigen::VectorXd parameters = mlp.parameters();
  // The problem owns the functions.
  for (Eigen::Index first = 0; first < inputs.rows(); first += kSamplesPerBlock) {
    const Eigen::Index count = std::min(kSamplesPerBlock, inputs.rows() - first);
    problem.AddResidualBlock(new ErrorFunction(inputs, targets, first, count, scratch), nullptr,
                             parameters.data());
  }
  if (weight_decay > 0.0) {
    problem.AddResidualBlock(new DecayFunction(weight_decay, mlp), nullptr, parameters.data());
  }
  ceres::Solver::Options options;
  options.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
  options.linear_solver_type = ceres::DENSE_NORMAL_CHOLESKY;
  options.max_num_iterations = max_iterations;
  options.function_tolerance = kFunctionTolerance;
  options.gradient_tolerance = kGradientTolerance;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  mlp.SetParameters(parameters);
  return {std::max(0, static_cast<int>(summary.iterations.size()) - 1),
          summary.termination_type == ceres::CONVERGENCE, summary.message};
}

Eigen::Index NumResiduals(const core::Matrix& targets, double weight_decay, const Mlp& mlp) {
  return targets.size() + (weight_decay > 0.0 ? NumWeights(mlp) : 0);
}

}  // namespace dfr::imitation::internal
