#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "dfr/core/files/archive.h"

namespace dfr::imitation::internal {

/// Stochastic gradient descent with moment estimates (Kingma and Ba, 2015, Algorithm 1).
class Adam {
 public:
  Adam(Eigen::Index parameters, double learning_rate);

  /// Takes one step along -`gradient`. Never allocates.
  void Step(const Eigen::VectorXd& gradient, Eigen::VectorXd& parameters) noexcept;

  void Save(core::ArchiveWriter& archive) const;
  /// Restores a saved state.
  /// @throws std::runtime_error if the number of parameters differs or a moment is impossible.
  void Load(core::ArchiveReader& archive);

 private:
  double learning_rate_;
  std::int64_t steps_ = 0;
  Eigen::VectorXd first_;
  Eigen::VectorXd second_;
};

}  // namespace dfr::imitation::internal
