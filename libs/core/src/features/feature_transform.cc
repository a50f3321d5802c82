#include "dfr/core/features/feature_transform.h"

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/local_scatter.h"
#include "dfr/core/numerics/quantile.h"

namespace dfr::core {
namespace {

// A feature counts as a function of time if its standard deviation is at most this share of its
// change per time step.
constexpr double kSameShare = 1e-6;
// Standard deviations below this fraction of the largest one are rounding errors.
constexpr double kLeastShare = 1e-12;

// Returns the root mean square change of each feature per time step.
Eigen::VectorXd Steps(std::span<const Matrix> features) {
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(features[0].cols());
  Eigen::Index count = 0;
  for (const Matrix& f : features) {
    const Eigen::Index steps = std::max<Eigen::Index>(f.rows() - 1, 0);
    sum += (f.bottomRows(steps) - f.topRows(steps)).colwise().squaredNorm().transpose();
    count += steps;
  }
  return (sum / static_cast<double>(std::max<Eigen::Index>(count, 1))).cwiseSqrt();
}

// Limits the number of features before computations whose cost grows with its square or faster.
void CheckNumFeatures(int features) {
  DFR_THROW_UNLESS(
      features <= FeatureTransform::kMaxFeatures,
      "at most " << FeatureTransform::kMaxFeatures << " features are supported, not " << features);
}

}  // namespace

FeatureTransform::FeatureTransform(FeatureSelection selection, Eigen::VectorXd offset, Matrix scale)
    : selection_(std::move(selection)), offset_(std::move(offset)), scale_(std::move(scale)) {
  const int features = selection_.num_features();
  CheckNumFeatures(features);
  DFR_THROW_UNLESS(offset_.size() == features, "the offset has " << offset_.size()
                                                                 << " entries for " << features
                                                                 << " features");
  DFR_THROW_UNLESS(scale_.rows() > 0 && scale_.cols() == features,
                   "the scale is " << scale_.rows() << " x " << scale_.cols() << " for " << features
                                   << " features");
  DFR_THROW_UNLESS(offset_.allFinite() && scale_.allFinite(),
                   "offset and scale of a feature transform must be finite");
}

FeatureTransform FeatureTransform::Identity(FeatureSelection selection) {
  const int n = selection.num_features();
  CheckNumFeatures(n);
  return {std::move(selection), Eigen::VectorXd::Zero(n), Matrix::Identity(n, n)};
}

FeatureTransform FeatureTransform::Whitening(FeatureSelection selection,
                                             std::span<const Matrix> demonstrations,
                                             const WhiteningOptions& options) {
  CheckNumFeatures(selection.num_features());
  DFR_THROW_UNLESS(demonstrations.size() >= 2,
                   "whitening needs at least 2 demonstrations, not " << demonstrations.size());
  const int median = MedianNumStates(demonstrations);
  const int n = selection.num_features();
  std::vector<Matrix> features;
  for (const Matrix& states : demonstrations) features.push_back(selection.Apply(states));

  Eigen::VectorXd sum = Eigen::VectorXd::Zero(n);
  std::vector<Matrix> steps;
  Eigen::Index count = 0;
  for (int t = 0; t < median; ++t) {
    Matrix here(std::ssize(features), n);
    Eigen::Index rows = 0;
    for (const Matrix& f : features) {
      if (t < f.rows()) here.row(rows++) = f.row(t);
    }
    here.conservativeResize(rows, Eigen::NoChange);
    sum += here.colwise().sum();
    count += rows;
    steps.push_back(std::move(here));
  }
  Matrix scatter = options.local ? LocalScatter(steps) : PooledCovariance(steps);

  Eigen::VectorXd sd = scatter.diagonal().cwiseSqrt();
  const double largest = sd.maxCoeff();
  DFR_THROW_UNLESS(largest > 0.0, "no selected feature ever differs between demonstrations");
  const Eigen::VectorXd step = Steps(features);
  const double rounding = kLeastShare * largest;
  for (Eigen::Index i = 0; i < n; ++i) {
    if (sd[i] > std::max(kSameShare * step[i], rounding)) continue;
    // The feature is the same function of time in all demonstrations. If its sd were far below its
    // change per time step, a small deviation from that change would outweigh all other features.
    const bool moves = step[i] > rounding;
    sd[i] = moves ? step[i] : largest;
    scatter.row(i).setZero();
    scatter.col(i).setZero();
    if (moves) scatter(i, i) = sd[i] * sd[i];
  }
  const Matrix inverse_sd = sd.cwiseInverse().asDiagonal();
  const Matrix correlation = inverse_sd * scatter * inverse_sd;
  Matrix scale = inverse_sd;
  if (options.decorrelate) {
    scale = InverseSquareRoot(correlation, options.ridge) * inverse_sd;
  }
  return {std::move(selection), sum / static_cast<double>(count), std::move(scale)};
}

void FeatureTransform::Apply(std::span<const double> state,
                             std::span<double> features) const noexcept {
  std::array<double, kMaxFeatures> selected;
  const auto n = static_cast<Eigen::Index>(selection_.num_features());
  selection_.Apply(state, selected);
  for (Eigen::Index i = 0; i < n; ++i) selected[static_cast<std::size_t>(i)] -= offset_[i];
  AsVector(features).noalias() =
      scale_.lazyProduct(Eigen::Map<const Eigen::VectorXd>(selected.data(), n));
}

Matrix FeatureTransform::Apply(const Matrix& states) const {
  DFR_THROW_UNLESS(states.cols() == state_dim(),
                   "states have " << states.cols() << " columns, not " << state_dim());
  Matrix features(states.rows(), num_features());
  for (Eigen::Index i = 0; i < states.rows(); ++i) Apply(Row(states, i), Row(features, i));
  return features;
}

int MedianNumStates(std::span<const Matrix> demonstrations) {
  DFR_THROW_UNLESS(!demonstrations.empty(), "there are no demonstrations");
  std::vector<Eigen::Index> lengths;
  for (const Matrix& states : demonstrations) lengths.push_back(states.rows());
  return static_cast<int>(Median(lengths));
}

}  // namespace dfr::core
