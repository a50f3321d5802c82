#include "dfr/control/assumptions.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "dfr/core/contract.h"

namespace dfr::control {
namespace {

void Check(std::span<const core::Trajectory> demonstrations, std::size_t least, double confidence) {
  DFR_THROW_UNLESS(confidence > 0.0 && confidence < 1.0,
                   "confidence must lie in (0, 1), not be " << confidence);
  DFR_THROW_UNLESS(demonstrations.size() >= least,
                   "at least " << least << " demonstrations, not " << demonstrations.size());
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    DFR_THROW_UNLESS(demonstrations[d].states.rows() == demonstrations[d].controls.rows() + 1,
                     "demonstration " << d << " has " << demonstrations[d].states.rows()
                                      << " states and " << demonstrations[d].controls.rows()
                                      << " controls");
  }
}

EstimatedConstant Finish(double value, int demonstrations, double confidence) {
  DFR_THROW_UNLESS(value > 0.0, "no demonstrated control has changed a feature");
  return {value, confidence, std::pow(1.0 - confidence, 1.0 / demonstrations), demonstrations};
}

}  // namespace

EstimatedConstant EstimateGain(const core::FeatureTransform& features,
                               std::span<const core::Trajectory> demonstrations,
                               double confidence) {
  Check(demonstrations, 1, confidence);
  double largest = 0.0;
  int moving = 0;
  for (const core::Trajectory& demonstration : demonstrations) {
    const core::Matrix z = features.Apply(demonstration.states);
    bool moves = false;
    for (Eigen::Index t = 0; t < demonstration.controls.rows(); ++t) {
      const double norm = demonstration.controls.row(t).norm();
      if (norm == 0.0) continue;
      largest = std::max(largest, (z.row(t + 1) - z.row(t)).norm() / norm);
      moves = true;
    }
    moving += moves ? 1 : 0;
  }
  return Finish(largest, std::max(1, moving), confidence);
}

EstimatedConstant EstimateDirectionError(const core::FeatureTransform& features,
                                         std::span<const core::Trajectory> demonstrations,
                                         const JacobianOptions& options, double confidence) {
  Check(demonstrations, 2, confidence);
  std::vector<core::Matrix> points;
  std::vector<core::Matrix> controls;
  double square = 0.0;
  int moving = 0;
  for (const core::Trajectory& demonstration : demonstrations) {
    points.push_back(features.Apply(demonstration.states));
    controls.push_back(demonstration.controls);
    for (Eigen::Index t = 0; t < demonstration.controls.rows(); ++t) {
      const double norm = demonstration.controls.row(t).squaredNorm();
      square += norm;
      moving += norm > 0.0 ? 1 : 0;
    }
  }
  DFR_THROW_UNLESS(moving > 0, "no demonstrated control differs from zero");
  const double unit = std::sqrt(square / moving);
  for (core::Matrix& c : controls) c /= unit;

  const std::size_t folds = std::min<std::size_t>(5, points.size());
  double largest = 0.0;
  for (std::size_t fold = 0; fold < folds; ++fold) {
    std::vector<core::Matrix> other_points;
    std::vector<core::Matrix> other_controls;
    for (std::size_t d = 0; d < points.size(); ++d) {
      if (d % folds == fold) continue;
      other_points.push_back(points[d]);
      other_controls.push_back(controls[d]);
    }
    // What is assumed is dz = J u, of controls that act at once.
    JacobianEstimate estimate(
        std::make_shared<const JacobianPrior>(other_points, other_controls, options), {},
        {.own_motion = false, .lag = false});
    for (std::size_t d = fold; d < points.size(); d += folds) {
      estimate.Reset();
      for (Eigen::Index t = 0; t < controls[d].rows(); ++t) {
        const Eigen::VectorXd v = controls[d].row(t);
        const Eigen::VectorXd z = points[d].row(t);
        const Eigen::VectorXd dz = points[d].row(t + 1).transpose() - z;
        estimate.Compute(static_cast<int>(t), core::AsSpan(z));
        const double norm = v.norm() * unit;
        if (norm == 0.0) continue;
        largest = std::max(largest, (dz - estimate.jacobian() * v).norm() / norm);
        estimate.Update(core::AsSpan(z), core::AsSpan(v), core::AsSpan(dz));
      }
    }
  }
  // An exactly linear system leaves no error at all; a certificate needs a positive one.
  return Finish(std::max(largest, 1e-12), static_cast<int>(points.size()), confidence);
}

}  // namespace dfr::control
