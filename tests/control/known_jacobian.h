#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "dfr/control/response/response_estimate.h"
#include "dfr/core/matrix.h"

namespace dfr::test {

/// Returns a fit to enough samples of z' = z + J v + s d to determine J and d to about 1e-9.
inline control::LocalFit KnownJacobian(const Eigen::MatrixXd& jacobian,
                                       const Eigen::VectorXd& disturbance = {},
                                       const control::DisturbanceModel& disturbance_model = {}) {
  const std::vector<core::Matrix> features = {core::Matrix::Zero(2, jacobian.rows())};
  const std::vector<core::Matrix> controls = {core::Matrix::Ones(1, jacobian.cols())};
  control::ResponseEstimate estimate(
      std::make_shared<const control::TransitionStore>(
          features, controls, control::ResponseOptions{.ridge = 1e-9, .prior_weight = 0.0}),
      disturbance_model, /*drift=*/false);
  control::LocalFit fit = estimate.MakeFit();
  for (Eigen::Index i = 0; i < jacobian.cols(); ++i) {
    for (const double size : {1.0, -2.0}) {
      const Eigen::VectorXd v = size * Eigen::VectorXd::Unit(jacobian.cols(), i);
      Eigen::VectorXd dz = jacobian * v;
      if (disturbance.size() > 0) dz += disturbance_model.Duration(v) * disturbance;
      estimate.Update(fit, core::AsSpan(v), core::AsSpan(dz));
    }
  }
  estimate.FitAt(0, fit.z(), fit);
  return fit;
}

}  // namespace dfr::test
