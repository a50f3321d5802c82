#include "dfr/imitation/fit_mlp.h"

#include <cmath>
#include <stdexcept>
#include <utility>

#include "checks.h"
#include "dfr/core/contract.h"
#include "mlp/mlp_cost.h"
#include "regression.h"

namespace dfr::imitation {
namespace {

using core::Matrix;

// Purposes of the random streams.
enum FitStream : std::uint64_t { kFitWeights, kFitShuffle };

// Maximum size of the Jacobian. Ceres keeps all of it in memory.
constexpr double kMostJacobianBytes = 2e9;

void CheckOptions(const FitMlpOptions& o) {
  DFR_THROW_UNLESS(o.control_limit > 0.0,
                   "control limit must be positive, not " << o.control_limit);
  DFR_THROW_UNLESS(std::isfinite(o.weight_decay) && o.weight_decay >= 0.0,
                   "weight decay must be finite and not negative: " << o.weight_decay);
  if (o.method == FitMethod::kAdam) {
    DFR_THROW_UNLESS(o.epochs > 0, "epochs must be positive, not " << o.epochs);
    DFR_THROW_UNLESS(o.batch > 0, "batch must be positive, not " << o.batch);
    DFR_THROW_UNLESS(std::isfinite(o.learning_rate) && o.learning_rate > 0.0,
                     "learning rate must be positive and finite, not " << o.learning_rate);
  } else {
    DFR_THROW_UNLESS(o.max_iterations > 0,
                     "max_iterations must be positive, not " << o.max_iterations);
  }
}

// Returns the rows of `values` with the indices `rows`.
Matrix Take(const Matrix& values, const std::vector<Eigen::Index>& rows) {
  Matrix taken(static_cast<Eigen::Index>(rows.size()), values.cols());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    taken.row(static_cast<Eigen::Index>(i)) = values.row(rows[i]);
  }
  return taken;
}

}  // namespace

MlpPolicy FitMlp(const core::StateLayout& layout, const Matrix& states, const Matrix& controls,
                 const FitMlpOptions& options, FitReport* report) {
  CheckOptions(options);
  DFR_THROW_UNLESS(states.cols() == layout.state_dim(),
                   "states have " << states.cols() << " columns, but their layout has "
                                  << layout.state_dim() << " entries");
  DFR_THROW_UNLESS(states.rows() == controls.rows(), "there are " << states.rows() << " states and "
                                                                  << controls.rows()
                                                                  << " controls");
  DFR_THROW_UNLESS(
      controls.rows() > 0 && controls.cols() > 0,
      "there is nothing to fit: controls are " << controls.rows() << " x " << controls.cols());
  internal::CheckFinite(states, "states");
  internal::CheckFinite(controls, "controls");

  std::vector<Eigen::Index> rows;
  for (Eigen::Index i = 0; i < controls.rows(); ++i) {
    if (!options.skip_zero_controls || !controls.row(i).isZero(0.0)) rows.push_back(i);
  }
  DFR_THROW_UNLESS(
      !rows.empty(),
      "all " << controls.rows() << " controls are zero, and zero controls are left out of the fit");
  const auto selection = core::FeatureSelection::Of(layout, options.features);
  const Matrix features = selection.Apply(Take(states, rows));
  Whitening whitening = Whitening::FromData(features);
  const Matrix inputs = whitening.Apply(features);
  const Matrix targets = Take(controls, rows);

  std::vector<int> sizes = {selection.num_features()};
  sizes.insert(sizes.end(), options.hidden.begin(), options.hidden.end());
  sizes.push_back(static_cast<int>(controls.cols()));
  core::Random weights(core::DeriveSeed(options.seed, {kFitWeights}));
  Mlp mlp(std::move(sizes), weights);

  internal::RegressionLoss loss(mlp, options.weight_decay);
  FitReport result;
  result.rows = static_cast<int>(rows.size());
  result.skipped_rows = static_cast<int>(controls.rows()) - result.rows;
  result.initial_loss = loss.Evaluate(mlp.parameters(), inputs, targets, nullptr);
  if (options.method == FitMethod::kAdam) {
    internal::Adam adam(mlp.num_parameters(), options.learning_rate);
    core::Random shuffle(core::DeriveSeed(options.seed, {kFitShuffle}));
    try {
      internal::FitByAdam(inputs, targets, options.epochs, options.batch, options.weight_decay,
                          adam, shuffle, mlp);
    } catch (const std::invalid_argument& e) {
      DFR_THROW_UNLESS(false, "Adam diverges; choose a smaller learning rate than "
                                  << options.learning_rate << ": " << e.what());
    }
    result.iterations = options.epochs;
    result.message = "all epochs done";
  } else {
    const bool lbfgs = options.method == FitMethod::kLbfgs;
    const Eigen::Index residuals = internal::NumResiduals(targets, options.weight_decay, mlp);
    const double bytes =
        static_cast<double>(residuals) * static_cast<double>(mlp.num_parameters()) * sizeof(double);
    DFR_THROW_UNLESS(lbfgs || bytes <= kMostJacobianBytes,
                     "Levenberg-Marquardt needs a Jacobian of "
                         << bytes / 1e9 << " GB for " << residuals << " residuals and "
                         << mlp.num_parameters()
                         << " parameters; at most 2 GB are allowed: use L-BFGS");
    internal::MinimizeSummary summary =
        lbfgs ? internal::MinimizeByLbfgs(inputs, targets, options.weight_decay,
                                          options.max_iterations, mlp)
              : internal::MinimizeByLevenbergMarquardt(inputs, targets, options.weight_decay,
                                                       options.max_iterations, mlp);
    result.iterations = summary.iterations;
    result.converged = summary.converged;
    result.message = std::move(summary.message);
  }
  result.final_loss = loss.Evaluate(mlp.parameters(), inputs, targets, nullptr);
  if (report != nullptr) *report = std::move(result);
  return {layout, options.features, std::move(whitening), std::move(mlp),
          Eigen::VectorXd::Constant(controls.cols(), options.control_limit)};
}

MlpPolicy FitMlp(const DemonstrationSet& demonstrations, const FitMlpOptions& options,
                 FitReport* report) {
  const int state_dim = demonstrations.layout.state_dim();
  const int control_dim = demonstrations.control_dim;
  Eigen::Index rows = 0;
  for (std::size_t i = 0; i < demonstrations.trajectories.size(); ++i) {
    const core::Trajectory& trajectory = demonstrations.trajectories[i];
    const Eigen::Index steps = trajectory.controls.rows();
    DFR_THROW_UNLESS(trajectory.states.rows() >= steps && trajectory.states.cols() == state_dim &&
                         trajectory.controls.cols() == control_dim,
                     "demonstration " << i << " has states of " << trajectory.states.rows() << " x "
                                      << trajectory.states.cols() << " and controls of " << steps
                                      << " x " << trajectory.controls.cols() << ", not " << steps
                                      << " + 1 x " << state_dim << " and " << steps << " x "
                                      << control_dim);
    internal::CheckFinite(trajectory.states, "states of demonstration " + std::to_string(i));
    internal::CheckFinite(trajectory.controls, "controls of demonstration " + std::to_string(i));
    rows += steps;
  }
  Matrix states(rows, state_dim);
  Matrix controls(rows, control_dim);
  Eigen::Index row = 0;
  for (const core::Trajectory& trajectory : demonstrations.trajectories) {
    const Eigen::Index steps = trajectory.controls.rows();
    states.middleRows(row, steps) = trajectory.states.topRows(steps);
    controls.middleRows(row, steps) = trajectory.controls;
    row += steps;
  }
  return FitMlp(demonstrations.layout, states, controls, options, report);
}

}  // namespace dfr::imitation
