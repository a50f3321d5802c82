#include "dfr/control/certified/certificate_constants.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "dfr/control/response/response_estimate.h"
#include "dfr/core/contract.h"
#include "dfr/core/numerics/folds.h"

namespace dfr::control {
namespace {

// The certificate assumes dz = J u with controls that act at once.
constexpr bool kDrift = false;

void Check(std::size_t demonstrations, std::size_t least, double confidence) {
  DFR_THROW_UNLESS(confidence > 0.0 && confidence < 1.0,
                   "confidence must lie in (0, 1), not " << confidence);
  DFR_THROW_UNLESS(demonstrations >= least,
                   "at least " << least << " demonstrations are needed, not " << demonstrations);
}

// Returns the largest |dz - J u| / |u|, with a J updated by the demonstration up to each step.
double LargestError(const core::Matrix& points, const core::Matrix& controls, double unit,
                    ResponseEstimate& estimate) {
  double largest = 0.0;
  LocalFit fit = estimate.MakeFit();
  estimate.Reset();
  for (Eigen::Index t = 0; t < controls.rows(); ++t) {
    const Eigen::VectorXd v = controls.row(t);
    const Eigen::VectorXd dz = points.row(t + 1) - points.row(t);
    const double norm = v.norm() * unit;
    if (norm == 0.0) continue;
    estimate.FitAt(static_cast<int>(t), core::Row(points, t), fit);
    largest = std::max(largest, (dz - fit.jacobian() * v).norm() / norm);
    estimate.Update(fit, core::AsSpan(v), core::AsSpan(dz));
  }
  return largest;
}

// An exactly linear system has no error, but a certificate needs a positive eps.
double AtLeastRounding(double error) { return std::max(error, 1e-12); }

// Only demonstrations with a nonzero control give a sample.
EstimatedConstant Finish(double value, int demonstrations, double confidence) {
  DFR_THROW_UNLESS(value > 0.0, "no demonstrated control has changed a feature");
  return {value, confidence, std::pow(1.0 - confidence, 1.0 / demonstrations), demonstrations};
}

}  // namespace

EstimatedConstant EstimateGain(const FeatureTrajectories& demonstrations, double confidence) {
  Check(demonstrations.points.size(), 1, confidence);
  double largest = 0.0;
  int moving = 0;
  for (std::size_t d = 0; d < demonstrations.points.size(); ++d) {
    const core::Matrix& z = demonstrations.points[d];
    const core::Matrix& controls = demonstrations.controls[d];
    bool moves = false;
    for (Eigen::Index t = 0; t < controls.rows(); ++t) {
      const double norm = controls.row(t).norm();
      if (norm == 0.0) continue;
      largest = std::max(largest, (z.row(t + 1) - z.row(t)).norm() / norm);
      moves = true;
    }
    moving += moves ? 1 : 0;
  }
  return Finish(largest, moving, confidence);
}

EstimatedConstant EstimateDirectionError(const FeatureTrajectories& demonstrations,
                                         const core::Folds& folds, const ResponseOptions& options,
                                         double confidence) {
  Check(demonstrations.points.size(), 2, confidence);
  const double unit = RootMeanSquare(demonstrations.controls);
  const std::vector<core::Matrix>& points = demonstrations.points;
  std::vector<core::Matrix> controls = demonstrations.controls;
  for (core::Matrix& c : controls) c /= unit;
  double largest = 0.0;
  for (std::size_t fold = 0; fold < folds.size(); ++fold) {
    ResponseEstimate estimate(
        std::make_shared<const TransitionStore>(core::WithoutFold(points, folds, fold),
                                                core::WithoutFold(controls, folds, fold), options),
        {}, kDrift);
    for (const std::size_t d : folds[fold]) {
      largest = std::max(largest, LargestError(points[d], controls[d], unit, estimate));
    }
  }
  const int moving = EstimateGain(demonstrations, confidence).demonstrations;
  return Finish(AtLeastRounding(largest), moving, confidence);
}

EstimatedConstant EstimateDirectionError(const core::FeatureTransform& features,
                                         std::span<const core::Trajectory> demonstrations,
                                         const ResponseOptions& options, double confidence) {
  Check(demonstrations.size(), 2, confidence);
  // In a deterministic order, sums have the same bits for any order of `demonstrations`.
  const FeatureTrajectories ordered(features, core::InDeterministicOrder(demonstrations));
  const int folds = static_cast<int>(std::min<std::size_t>(5, demonstrations.size()));
  return EstimateDirectionError(ordered, core::StratifiedFolds(ordered.points, folds), options,
                                confidence);
}

EstimatedConstant EstimateDirectionError(const Response& response,
                                         const FeatureTrajectories& held_out, double confidence) {
  Check(held_out.points.size(), 1, confidence);
  ResponseEstimate estimate(response.prior(), {}, kDrift);
  const double unit = response.control_unit();
  double largest = 0.0;
  for (std::size_t d = 0; d < held_out.points.size(); ++d) {
    largest = std::max(
        largest, LargestError(held_out.points[d], held_out.controls[d] / unit, unit, estimate));
  }
  const int moving = EstimateGain(held_out, confidence).demonstrations;
  return Finish(AtLeastRounding(largest), moving, confidence);
}

double LargestChangeAtRest(const FeatureTrajectories& demonstrations) {
  double largest = 0.0;
  for (std::size_t d = 0; d < demonstrations.points.size(); ++d) {
    const core::Matrix& z = demonstrations.points[d];
    for (Eigen::Index t = 0; t < demonstrations.controls[d].rows(); ++t) {
      if (!demonstrations.controls[d].row(t).isZero(0.0)) continue;
      largest = std::max(largest, (z.row(t + 1) - z.row(t)).norm());
    }
  }
  return largest;
}

}  // namespace dfr::control
