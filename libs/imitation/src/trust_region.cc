#include "trust_region.h"

namespace dfr::imitation::internal {
namespace {

// log N(u; mean, diag(exp(2 log_std))) up to a constant common to all policies.
Eigen::VectorXd LogDensity(const core::Matrix& controls, const Rows& means,
                           const Eigen::VectorXd& log_std) {
  const Eigen::RowVectorXd inverse_std = (-log_std.array()).exp().matrix().transpose();
  return (-0.5 * ((controls - means).array().rowwise() * inverse_std.array())
                     .square()
                     .rowwise()
                     .sum() -
          log_std.sum())
      .matrix();
}

}  // namespace

TrustRegionProblem::TrustRegionProblem(const Mlp& mlp, const Eigen::VectorXd& log_std,
                                       const core::Matrix& inputs, const core::Matrix& controls,
                                       const Eigen::VectorXd& advantages)
    : mlp_(mlp),
      moved_(mlp),
      theta_(mlp.num_parameters() + log_std.size()),
      inputs_(inputs),
      controls_(controls),
      advantages_(advantages),
      gradient_(theta_.size()) {
  theta_ << mlp.parameters(), log_std;
  old_means_ = mlp_.Forward(inputs_, workspace_);
  old_inverse_variance_ = (-2.0 * log_std.array()).exp().matrix().transpose();
  old_log_density_ = LogDensity(controls_, old_means_, log_std);

  // d log pi / d mean = (u - mean) / variance; d log pi / d log_std = (u - mean)^2 / variance - 1.
  const auto n = static_cast<double>(inputs_.rows());
  output_gradient_ =
      ((controls_ - old_means_).array().rowwise() * old_inverse_variance_.array()).colwise() *
      (advantages_.array() / n);
  mlp_.Backward(inputs_, output_gradient_, workspace_, network_part_);
  const Eigen::RowVectorXd deviation_part =
      output_gradient_.cwiseProduct(controls_ - old_means_).colwise().sum().array() -
      advantages_.mean();
  gradient_ << network_part_, deviation_part.transpose();
}

void TrustRegionProblem::FisherVectorProduct(const Eigen::VectorXd& v, Eigen::VectorXd& product) {
  const Eigen::Index network = mlp_.num_parameters();
  output_gradient_ = mlp_.Tangent(inputs_, v.head(network), workspace_);
  output_gradient_.array().rowwise() *=
      old_inverse_variance_.array() / static_cast<double>(inputs_.rows());
  mlp_.Backward(inputs_, output_gradient_, workspace_, network_part_);
  product.resize(v.size());
  product.head(network) = network_part_;
  product.tail(v.size() - network) = 2.0 * v.tail(v.size() - network);
}

TrustRegionProblem::Value TrustRegionProblem::Evaluate(const Eigen::VectorXd& theta) {
  const Eigen::Index network = mlp_.num_parameters();
  const Eigen::VectorXd log_std = theta.tail(theta.size() - network);
  const Eigen::VectorXd old_log_std = theta_.tail(theta.size() - network);
  moved_.SetParameters(theta.head(network));
  const Eigen::Map<const core::Matrix> means = moved_.Forward(inputs_, moved_workspace_);
  const Eigen::VectorXd log_ratio = LogDensity(controls_, means, log_std) - old_log_density_;
  const double gain = ((log_ratio.array().exp() - 1.0) * advantages_.array()).mean();

  // KL(N_old, N_new) = sum log(s_new/s_old) + (s_old^2 + (m_old - m_new)^2) / (2 s_new^2) - 1/2.
  const Eigen::ArrayXd inverse_variance = (-2.0 * log_std.array()).exp();
  const Eigen::ArrayXd shift = (means - old_means_).array().square().colwise().mean().transpose();
  const double kl = (log_std.array() - old_log_std.array() +
                     0.5 * inverse_variance * ((2.0 * old_log_std.array()).exp() + shift) - 0.5)
                        .sum();
  return {gain, kl};
}

Eigen::VectorXd ConjugateGradient(
    const std::function<void(const Eigen::VectorXd&, Eigen::VectorXd&)>& product,
    const Eigen::VectorXd& b, int iterations) {
  Eigen::VectorXd x = Eigen::VectorXd::Zero(b.size());
  Eigen::VectorXd residual = b;
  Eigen::VectorXd direction = b;
  Eigen::VectorXd image(b.size());
  double square = residual.squaredNorm();
  const double enough = 1e-20 * square;
  for (int i = 0; i < iterations && square > enough; ++i) {
    product(direction, image);
    const double step = square / direction.dot(image);
    x += step * direction;
    residual -= step * image;
    const double next = residual.squaredNorm();
    direction = residual + (next / square) * direction;
    square = next;
  }
  return x;
}

}  // namespace dfr::imitation::internal
