#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <span>

#include "dfr/core/random.h"
#include "dfr/imitation/mlp_policy.h"

namespace dfr::imitation {

/// A stochastic policy u ~ N(mlp(z), diag(exp(2 log_std))), clipped to the control limit. Trpo
/// trains such policies, and files store supervisors in this form. The standard deviation does not
/// depend on the state. Immutable; concurrent calls are safe if each uses its own random stream.
class GaussianPolicy {
 public:
  /// @throws std::invalid_argument unless `log_std` has one finite entry per control.
  GaussianPolicy(MlpPolicy mean, Eigen::VectorXd log_std);

  [[nodiscard]] int state_dim() const noexcept { return mean_.state_dim(); }
  [[nodiscard]] int control_dim() const noexcept { return mean_.control_dim(); }

  /// Samples a control: adds noise to the network's output, then clips the sum. All entries are NaN
  /// if the output is NaN. Never allocates.
  void Sample(std::span<const double> x, core::Random& random, std::span<double> u) const noexcept;

  /// Returns the policy without noise.
  [[nodiscard]] const MlpPolicy& mean() const noexcept { return mean_; }
  [[nodiscard]] const Eigen::VectorXd& log_std() const noexcept { return log_std_; }

  /// Writes a file of kind "gaussian-policy". @throws std::runtime_error naming the file.
  void Save(const std::filesystem::path& path) const;
  /// @throws std::runtime_error naming the file and the problem.
  static GaussianPolicy Load(const std::filesystem::path& path);

 private:
  MlpPolicy mean_;
  Eigen::VectorXd log_std_;
};

}  // namespace dfr::imitation
