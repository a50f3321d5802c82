#include "dfr/control/certified/assumptions.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>
#include <vector>

#include "dfr/control/guided/jacobian_estimate.h"
#include "dfr/core/contract.h"
#include "dfr/core/folds.h"

namespace dfr::control {
namespace {

// What is assumed is dz = J u, of controls that act at once.
constexpr bool kOwnMotion = false;

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

// The root mean square of the demonstrated controls that are not zero.
double RootMeanSquare(std::span<const core::Trajectory> demonstrations) {
  double square = 0.0;
  int moving = 0;
  for (const std::size_t d : core::ContentOrder(demonstrations)) {
    for (const auto& control : demonstrations[d].controls.rowwise()) {
      square += control.squaredNorm();
      moving += control.squaredNorm() > 0.0 ? 1 : 0;
    }
  }
  DFR_THROW_UNLESS(moving > 0, "no demonstrated control differs from zero");
  return std::sqrt(square / moving);
}

// A demonstration as JacobianPrior has it.
struct Transitions {
  Transitions(const core::FeatureTransform& features, const core::Trajectory& demonstration,
              double unit)
      : points(features.Apply(demonstration.states)), controls(demonstration.controls / unit) {}
  core::Matrix points;
  core::Matrix controls;
};

// The largest |dz - J u| / |u|, J with what the demonstration itself has shown until then.
double LargestError(const Transitions& transitions, double unit, JacobianEstimate& estimate) {
  double largest = 0.0;
  estimate.Reset();
  for (Eigen::Index t = 0; t < transitions.controls.rows(); ++t) {
    const Eigen::VectorXd v = transitions.controls.row(t);
    const Eigen::VectorXd z = transitions.points.row(t);
    const Eigen::VectorXd dz = transitions.points.row(t + 1).transpose() - z;
    const double norm = v.norm() * unit;
    if (norm == 0.0) continue;
    estimate.Compute(static_cast<int>(t), core::AsSpan(z));
    largest = std::max(largest, (dz - estimate.jacobian() * v).norm() / norm);
    estimate.Update(core::AsSpan(z), core::AsSpan(v), core::AsSpan(dz));
  }
  return largest;
}

// An exactly linear system leaves no error at all; a certificate needs a positive one.
double AtLeastRounding(double error) { return std::max(error, 1e-12); }

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
  const double unit = RootMeanSquare(demonstrations);
  std::vector<Transitions> all;
  std::vector<core::Matrix> points;
  all.reserve(demonstrations.size());
  points.reserve(demonstrations.size());
  // In this order sums have the same bits, whatever the order of the demonstrations.
  for (const std::size_t d : core::ContentOrder(demonstrations)) {
    all.emplace_back(features, demonstrations[d], unit);
    points.push_back(all.back().points);
  }
  std::vector<std::size_t> order(all.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  const core::Folds folds = core::StratifiedFolds(
      points, static_cast<int>(std::min<std::size_t>(5, demonstrations.size())));
  double largest = 0.0;
  for (std::size_t fold = 0; fold < folds.size(); ++fold) {
    std::vector<core::Matrix> other_points;
    std::vector<core::Matrix> other_controls;
    other_points.reserve(all.size());
    other_controls.reserve(all.size());
    for (const std::size_t d : core::Others(folds, fold, order)) {
      other_points.push_back(all[d].points);
      other_controls.push_back(all[d].controls);
    }
    JacobianEstimate estimate(
        std::make_shared<const JacobianPrior>(other_points, other_controls, options), {},
        kOwnMotion);
    for (const std::size_t d : folds[fold]) {
      largest = std::max(largest, LargestError(all[d], unit, estimate));
    }
  }
  return Finish(AtLeastRounding(largest), static_cast<int>(all.size()), confidence);
}

EstimatedConstant EstimateDirectionError(const GuidedModel& model,
                                         std::span<const core::Trajectory> held_out,
                                         double confidence) {
  Check(held_out, 1, confidence);
  JacobianEstimate estimate(model.prior(), {}, kOwnMotion);
  double largest = 0.0;
  for (const core::Trajectory& demonstration : held_out) {
    const Transitions transitions(model.features(), demonstration, model.control_unit());
    largest = std::max(largest, LargestError(transitions, model.control_unit(), estimate));
  }
  return Finish(AtLeastRounding(largest), static_cast<int>(held_out.size()), confidence);
}

}  // namespace dfr::control
