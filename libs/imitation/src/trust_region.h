#pragma once

#include <Eigen/Core>
#include <functional>

#include "dfr/core/matrix.h"
#include "dfr/imitation/mlp.h"

namespace dfr::imitation::internal {

/// One policy update of TRPO as a constrained problem in theta = (network parameters, log_std):
///   maximise mean_i A_i pi_theta(u_i | z_i) / pi_old(u_i | z_i)  with  mean_i KL(pi_old, pi_theta)
/// bounded, for a Gaussian policy whose deviation does not depend on the state.
class TrustRegionProblem {
 public:
  /// Takes `inputs` (n x network inputs), the `controls` that the old policy (`mlp`, `log_std`)
  /// drew there (n x outputs, before any limit), and one advantage per control. Borrows all
  /// matrices.
  TrustRegionProblem(const Mlp& mlp, const Eigen::VectorXd& log_std, const core::Matrix& inputs,
                     const core::Matrix& controls, const Eigen::VectorXd& advantages);

  /// Old network parameters, then log_std.
  [[nodiscard]] const Eigen::VectorXd& theta() const noexcept { return theta_; }

  /// Returns the gradient of the surrogate at the old policy.
  [[nodiscard]] const Eigen::VectorXd& gradient() const noexcept { return gradient_; }

  /// Computes `product` = F v with F the Hessian of the mean KL at the old policy. For a Gaussian,
  ///   F = diag(J' diag(exp(-2 log_std)) J / n, 2 I)
  /// with J the derivative of the means with respect to the network parameters. Costs a tangent and
  /// a backward pass; F is never formed.
  void FisherVectorProduct(const Eigen::VectorXd& v, Eigen::VectorXd& product);

  struct Value {
    double gain;  ///< The surrogate minus its value at the old policy.
    double kl;    ///< Mean KL divergence from the old policy.
  };
  [[nodiscard]] Value Evaluate(const Eigen::VectorXd& theta);

 private:
  Mlp mlp_;
  Mlp moved_;
  Eigen::VectorXd theta_;
  const core::Matrix& inputs_;
  const core::Matrix& controls_;
  const Eigen::VectorXd& advantages_;
  core::Matrix old_means_;
  Eigen::RowVectorXd old_inverse_variance_;
  Eigen::VectorXd old_log_density_;
  Eigen::VectorXd gradient_;
  core::Matrix output_gradient_;
  Eigen::VectorXd network_part_;
  Mlp::Workspace workspace_;  // keeps the activations of the old policy
  Mlp::Workspace moved_workspace_;
};

/// Solves A x = b for a positive definite A, starting at x = 0. `product` computes A v. Stops after
/// `iterations` steps or when the residual is below 1e-10 |b| (Hestenes and Stiefel, 1952).
[[nodiscard]] Eigen::VectorXd ConjugateGradient(
    const std::function<void(const Eigen::VectorXd&, Eigen::VectorXd&)>& product,
    const Eigen::VectorXd& b, int iterations);

}  // namespace dfr::imitation::internal
