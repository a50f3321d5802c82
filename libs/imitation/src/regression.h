#pragma once

#include <Eigen/Core>

#include "dfr/core/random.h"
#include "dfr/imitation/mlp.h"
#include "mlp/adam.h"

namespace dfr::imitation::internal {

/// loss = mean_i |mlp(x_i) - t_i|^2 / 2 + weight_decay |W|^2 / 2, where W are all weights without
/// the biases.
class RegressionLoss {
 public:
  /// Uses the layer sizes of `mlp`, not its parameters.
  RegressionLoss(Mlp mlp, double weight_decay);

  /// Returns the loss of `parameters` and writes its gradient unless `gradient` is null.
  /// @throws std::invalid_argument for a parameter that is not finite.
  double Evaluate(const Eigen::Ref<const Eigen::VectorXd>& parameters, const Rows& inputs,
                  const Rows& targets, Eigen::VectorXd* gradient);

 private:
  Mlp mlp_;
  double weight_decay_;
  core::Matrix error_;
  Mlp::Workspace workspace_;
};

/// Runs mini-batch Adam over the rows of `inputs` and `targets`, reshuffled in each pass. The last
/// batch of a pass has the remaining rows.
void FitByAdam(const core::Matrix& inputs, const core::Matrix& targets, int epochs, int batch,
               double weight_decay, Adam& adam, core::Random& random, Mlp& mlp);

}  // namespace dfr::imitation::internal
