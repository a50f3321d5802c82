#include "dfr/reduction/action_directions.h"

#include <algorithm>
#include <cmath>

#include "dfr/core/numerics/folds.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/reduction/slow_features.h"

namespace dfr::reduction {
namespace {

// Maximum number of states in the regression. The cost grows with its third power.
constexpr Eigen::Index kMostSamples = 500;
constexpr double kKernelRidge = 0.03;
// Variance of the progress in the regression, in which the actions have variance 1.
constexpr double kProgress = 0.1;
// Number of regressions whose metric comes from the gradients of the previous regression.
constexpr int kMetrics = 2;

// Returns the mean outer product of the gradients of the kernel regression of `y` on `x`, whose
// kernel has the metric `metric`.
Eigen::MatrixXd GradientProducts(const Eigen::MatrixXd& x, const Eigen::MatrixXd& y,
                                 const Eigen::MatrixXd& metric) {
  const Eigen::MatrixXd scaled = core::Multiply(x, metric);
  const Eigen::VectorXd norms = scaled.cwiseProduct(x).rowwise().sum();
  Eigen::MatrixXd kernel = -2.0 * core::Multiply(scaled, x.transpose());
  kernel.colwise() += norms;
  kernel.rowwise() += norms.transpose();
  const double unit = kernel.mean();  // Squared length scale of the kernel.
  if (!(unit > 0.0)) return Eigen::MatrixXd::Identity(x.cols(), x.cols());
  kernel = (kernel.array() / (-2.0 * unit)).min(0.0).exp().matrix();
  Eigen::MatrixXd regular = kernel;
  regular.diagonal().array() += kKernelRidge;
  const Eigen::MatrixXd weights = core::SolveSymmetric(regular, y);
  Eigen::MatrixXd products = Eigen::MatrixXd::Zero(x.cols(), x.cols());
  for (Eigen::Index k = 0; k < y.cols(); ++k) {
    const Eigen::VectorXd weight = weights.col(k);
    // Row i: the sum over samples j of K_ij w_j (x_j - x_i), multiplied by metric / unit.
    Eigen::MatrixXd gradients = core::Multiply(kernel, weight.asDiagonal() * scaled);
    gradients -= (kernel * weight).asDiagonal() * scaled;
    gradients /= unit;
    products += core::Multiply(gradients.transpose(), gradients);
  }
  return products / static_cast<double>(x.rows());
}

// Returns these columns of the states of all demonstrations.
std::vector<core::Matrix> ColumnsOf(std::span<const core::Trajectory> demonstrations,
                                    std::span<const std::size_t> order,
                                    const std::vector<int>& columns) {
  std::vector<core::Matrix> parts;
  parts.reserve(order.size());
  for (const std::size_t d : order) {
    parts.emplace_back(demonstrations[d].states(Eigen::all, columns));
  }
  return parts;
}

bool Varies(const std::vector<core::Matrix>& parts) {
  return std::ranges::any_of(parts, [&](const core::Matrix& part) {
    return (part.rowwise() - parts[0].row(0)).cwiseAbs().maxCoeff() > 0.0;
  });
}

}  // namespace

ActionDirections::ActionDirections(std::span<const core::Trajectory> demonstrations,
                                   std::span<const std::vector<int>> blocks) {
  const std::vector<std::size_t> order = core::DeterministicOrder(demonstrations);
  std::vector<std::vector<int>> all(blocks.begin(), blocks.end());
  // Adds a separate block for each other column that varies.
  for (int i = 0; i < demonstrations[0].states.cols(); ++i) {
    const bool taken = std::ranges::any_of(
        blocks, [&](const std::vector<int>& block) { return std::ranges::count(block, i) > 0; });
    if (!taken && Varies(ColumnsOf(demonstrations, order, {i}))) all.push_back({i});
  }
  Eigen::Index actions = 0;
  for (const core::Trajectory& d : demonstrations) actions += d.controls.rows();
  const Eigen::Index stride =
      std::max<Eigen::Index>(1, (actions + kMostSamples - 1) / kMostSamples);
  const Eigen::Index samples = (actions + stride - 1) / stride;
  const Eigen::Index control_dim = demonstrations[0].controls.cols();
  Eigen::MatrixXd y(samples, control_dim + 1);  // Actions, and the progress in the last column.
  std::vector<Eigen::MatrixXd> features;
  Eigen::Index width = 0;
  for (const std::vector<int>& columns : all) {
    const std::vector<core::Matrix> parts = ColumnsOf(demonstrations, order, columns);
    SlowFeatures slow = FitSlowFeatures(parts);
    Eigen::MatrixXd x(samples, slow.directions.rows());
    Eigen::Index next = 0;
    for (std::size_t i = 0; i < order.size(); ++i) {
      const core::Matrix& controls = demonstrations[order[i]].controls;
      for (Eigen::Index t = 0; t < controls.rows(); ++t, ++next) {
        if (next % stride != 0) continue;
        x.row(next / stride) =
            (parts[i].row(t) - slow.mean.transpose()) * slow.directions.transpose();
        y.row(next / stride).head(control_dim) = controls.row(t);
        y(next / stride, control_dim) =
            static_cast<double>(t) / static_cast<double>(controls.rows());
      }
    }
    width += x.cols();
    features.push_back(std::move(x));
    if (blocks_.size() < blocks.size()) {
      blocks_.push_back({std::move(slow.directions), std::move(slow.slowness), {}});
    }
  }
  y.rowwise() -= y.colwise().mean().eval();
  const double actions_norm = y.leftCols(control_dim).norm();
  const double progress_norm = y.col(control_dim).norm();
  if (actions_norm > 0.0) y.leftCols(control_dim) /= actions_norm;
  if (progress_norm > 0.0) y.col(control_dim) *= std::sqrt(kProgress) / progress_norm;
  Eigen::MatrixXd x(samples, width);
  Eigen::Index first = 0;
  for (const Eigen::MatrixXd& part : features) {
    x.middleCols(first, part.cols()) = part;
    first += part.cols();
  }
  Eigen::MatrixXd metric = Eigen::MatrixXd::Identity(width, width);
  for (int i = 0; i <= kMetrics; ++i) {
    metric = GradientProducts(x, y, metric);
    const double trace = metric.trace();
    if (!(trace > 0.0)) {
      metric.setIdentity();
      break;
    }
    metric *= static_cast<double>(width) / trace;
  }
  first = 0;
  for (Block& block : blocks_) {
    const Eigen::Index size = block.slow.rows();
    block.relevant = core::DecomposeSymmetric(metric.block(first, first, size, size))
                         .vectors.rowwise()
                         .reverse();
    first += size;
  }
}

core::Matrix ActionDirections::Weights(std::size_t block, int components) const {
  const Block& own = blocks_[block];
  const auto first = own.relevant.leftCols(std::min<Eigen::Index>(components, own.relevant.cols()));
  const core::SymmetricEigen slow = core::DecomposeSymmetric(
      core::Multiply(first.transpose() * own.slowness.asDiagonal(), first));
  const Eigen::MatrixXd directions = core::Multiply(first, slow.vectors.rowwise().reverse());
  core::Matrix weights = core::Multiply(directions.transpose(), own.slow);
  for (auto row : weights.rowwise()) {
    Eigen::Index largest = 0;
    row.cwiseAbs().maxCoeff(&largest);
    if (row[largest] < 0.0) row *= -1.0;
  }
  return weights;
}

}  // namespace dfr::reduction
