#include "dfr/reduction/slow_features.h"

#include <Eigen/Core>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/linear_algebra.h"

namespace dfr::reduction {
namespace {

// Fraction of the entries' mean variance that is added to the covariance of differences.
constexpr double kLeastDifference = 1e-6;
// A direction varies if its slowness exceeds this value. White noise has 1/2.
constexpr double kLeastSlowness = 1e-6;

}  // namespace

SlowFeatures FitSlowFeatures(std::span<const core::Matrix> episodes) {
  DFR_THROW_UNLESS(!episodes.empty() && episodes[0].cols() > 0, "slow features need episodes");
  const Eigen::Index d = episodes[0].cols();
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(d);
  Eigen::VectorXd moved = Eigen::VectorXd::Zero(d);
  double rows = 0.0;
  double steps = 0.0;
  for (std::size_t i = 0; i < episodes.size(); ++i) {
    const core::Matrix& x = episodes[i];
    DFR_THROW_UNLESS(x.cols() == d,
                     "episode " << i << " has " << x.cols() << " columns, but episode 0 has " << d);
    DFR_THROW_UNLESS(x.allFinite(), "episode " << i << " has an entry that is not finite");
    if (x.rows() == 0) continue;
    sum += x.colwise().sum().transpose();
    moved += (x.bottomRows(1) - x.topRows(1)).transpose();
    rows += static_cast<double>(x.rows());
    steps += static_cast<double>(x.rows() - 1);
  }
  DFR_THROW_UNLESS(steps > 0.0, "slow features need an episode of at least two states");
  SlowFeatures fit{.mean = sum / rows, .directions = {}, .slowness = {}};
  moved /= steps;
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(d, d);
  Eigen::MatrixXd differences = Eigen::MatrixXd::Zero(d, d);
  for (const core::Matrix& x : episodes) {
    if (x.rows() == 0) continue;
    const core::Matrix centred = x.rowwise() - fit.mean.transpose();
    all += core::Multiply(centred.transpose(), centred);
    const core::Matrix step =
        (x.bottomRows(x.rows() - 1) - x.topRows(x.rows() - 1)).rowwise() - moved.transpose();
    differences += core::Multiply(step.transpose(), step);
  }
  all /= rows;
  differences /= steps;
  const double variance = all.trace() / static_cast<double>(d);
  DFR_THROW_UNLESS(variance > 0.0, "all rows are equal: there is nothing to reduce");
  differences.diagonal().array() += kLeastDifference * variance;
  const core::SymmetricEigen eigen = core::DecomposeSymmetric(all, differences);
  Eigen::Index kept = 1;
  while (kept < d && eigen.values[d - 1 - kept] > kLeastSlowness) ++kept;
  fit.slowness = eigen.values.reverse().head(kept);
  fit.directions = eigen.vectors.rowwise().reverse().leftCols(kept).transpose();
  for (Eigen::Index k = 0; k < kept; ++k) {
    Eigen::Index largest = 0;
    fit.directions.row(k).cwiseAbs().maxCoeff(&largest);
    if (fit.directions(k, largest) < 0.0) fit.directions.row(k) *= -1.0;
  }
  return fit;
}

}  // namespace dfr::reduction
