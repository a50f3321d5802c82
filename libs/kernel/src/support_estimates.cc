#include "dfr/kernel/support_estimates.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/linear_algebra.h"
#include "states_at.h"

namespace dfr::kernel {
namespace {

constexpr double kOutside = -std::numeric_limits<double>::infinity();

void CheckSamples(const Eigen::Ref<const core::Matrix>& samples, Eigen::Index least) {
  DFR_THROW_UNLESS(samples.rows() >= least,
                   "at least " << least << " samples are needed; there are " << samples.rows());
  DFR_THROW_UNLESS(samples.cols() >= 1 && samples.cols() <= OneClassSvm::kMaxStateDim,
                   "a sample must have 1 to " << OneClassSvm::kMaxStateDim << " entries, not "
                                              << samples.cols());
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    DFR_THROW_UNLESS(samples.row(i).allFinite(), "sample " << i << " has a non-finite entry");
  }
}

void CheckNu(double nu) {
  DFR_THROW_UNLESS(nu > 0.0 && nu <= 1.0, "nu must lie in (0, 1], not " << nu);
}

// Returns the value that floor(nu m) of the others exceed.
double ValueExceededBy(std::vector<double> values, double nu) {
  const auto m = static_cast<double>(values.size());
  const auto rank = std::min(static_cast<std::ptrdiff_t>(std::floor(nu * m)),
                             static_cast<std::ptrdiff_t>(values.size()) - 1);
  std::nth_element(values.begin(), values.begin() + rank, values.end(), std::greater<>());
  return values[static_cast<std::size_t>(rank)];
}

core::Matrix Covariance(const Eigen::Ref<const core::Matrix>& samples,
                        const Eigen::VectorXd& mean) {
  const core::Matrix centered = samples.rowwise() - mean.transpose();
  return centered.transpose() * centered / static_cast<double>(samples.rows());
}

bool Fits(std::span<const double> x, int state_dim) noexcept {
  if (static_cast<int>(x.size()) != state_dim) return false;
  return std::all_of(x.begin(), x.end(), [](double v) { return std::isfinite(v); });
}

}  // namespace

OneClassSvm FitKernelDensity(const Eigen::Ref<const core::Matrix>& samples, double nu,
                             double gamma) {
  CheckSamples(samples, 2);
  CheckNu(nu);
  const auto m = static_cast<double>(samples.rows());
  const Eigen::VectorXd weights = Eigen::VectorXd::Constant(samples.rows(), 1.0 / m);
  const OneClassSvm sum = OneClassSvm::FromParts(samples, weights, gamma, 0.0);
  std::vector<double> density(static_cast<std::size_t>(samples.rows()));
  sum.DecisionBatch(samples, density);
  // Negated, because a share nu stays below rho. Each sample excludes its own kernel.
  for (double& d : density) d = -(d - 1.0 / m) * m / (m - 1.0);
  const double rho = -ValueExceededBy(std::move(density), nu);
  return OneClassSvm::FromParts(samples, weights, gamma, rho);
}

GaussianEstimate GaussianEstimate::Fit(const Eigen::Ref<const core::Matrix>& samples, double nu,
                                       double ridge) {
  CheckSamples(samples, 2);
  CheckNu(nu);
  DFR_THROW_UNLESS(ridge >= 0.0 && std::isfinite(ridge),
                   "ridge must be finite and not negative: " << ridge);
  GaussianEstimate estimate;
  estimate.mean_ = samples.colwise().mean();
  Eigen::MatrixXd covariance = Covariance(samples, estimate.mean_);
  covariance.diagonal().array() += ridge * covariance.diagonal().mean();
  const Eigen::LLT<Eigen::MatrixXd> cholesky(covariance);
  DFR_THROW_UNLESS(cholesky.info() == Eigen::Success,
                   "the samples' covariance is singular; give a larger ridge than " << ridge);
  estimate.root_ =
      cholesky.matrixL().solve(Eigen::MatrixXd::Identity(samples.cols(), samples.cols()));
  estimate.lipschitz_bound_ = core::OperatorNorm(estimate.root_);
  std::vector<double> distances;
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    distances.push_back((estimate.root_ * (samples.row(i).transpose() - estimate.mean_)).norm());
  }
  estimate.radius_ = ValueExceededBy(std::move(distances), nu);
  return estimate;
}

double GaussianEstimate::Decision(std::span<const double> x) const noexcept {
  if (!Fits(x, state_dim())) return kOutside;
  double squared = 0.0;
  for (Eigen::Index i = 0; i < root_.rows(); ++i) {
    double y = 0.0;
    for (Eigen::Index k = 0; k <= i; ++k) {  // lower triangular
      y += root_(i, k) * (x[static_cast<std::size_t>(k)] - mean_[k]);
    }
    squared += y * y;
  }
  return radius_ - std::sqrt(squared);
}

double GaussianEstimate::Gradient(std::span<const double> x,
                                  std::span<double> gradient) const noexcept {
  std::fill(gradient.begin(), gradient.end(), 0.0);
  if (gradient.size() != x.size()) return kOutside;
  const double g = Decision(x);
  const double distance = radius_ - g;
  if (!(distance > 0.0) || !std::isfinite(distance)) return g;  // not smooth at the mean
  for (Eigen::Index i = 0; i < root_.rows(); ++i) {
    double y = 0.0;
    for (Eigen::Index k = 0; k <= i; ++k) {
      y += root_(i, k) * (x[static_cast<std::size_t>(k)] - mean_[k]);
    }
    for (Eigen::Index k = 0; k <= i; ++k) {
      gradient[static_cast<std::size_t>(k)] -= root_(i, k) * y / distance;
    }
  }
  return g;
}

NeighbourEstimate NeighbourEstimate::Fit(const Eigen::Ref<const core::Matrix>& samples, double nu,
                                         int k) {
  CheckNu(nu);
  DFR_THROW_UNLESS(k >= 1 && k <= kMostNeighbours,
                   "k must lie in [1, " << kMostNeighbours << "], not " << k);
  CheckSamples(samples, k + 1);
  NeighbourEstimate estimate;
  estimate.samples_ = samples;
  estimate.k_ = k;
  std::vector<double> distances;
  for (Eigen::Index i = 0; i < samples.rows(); ++i) {
    const double* x = estimate.samples_.data() + i * samples.cols();
    distances.push_back(std::sqrt(estimate.Nearest(x, i).squared_distance));
  }
  estimate.radius_ = ValueExceededBy(std::move(distances), nu);
  return estimate;
}

NeighbourEstimate::Neighbour NeighbourEstimate::Nearest(const double* x,
                                                        Eigen::Index except) const noexcept {
  // The k nearest so far, in ascending order.
  Neighbour nearest[kMostNeighbours];
  std::fill_n(nearest, k_, Neighbour{std::numeric_limits<double>::infinity(), 0});
  for (Eigen::Index i = 0; i < samples_.rows(); ++i) {
    if (i == except) continue;
    const double* sample = samples_.data() + i * samples_.cols();
    double squared = 0.0;
    for (Eigen::Index k = 0; k < samples_.cols(); ++k) {
      squared += (x[k] - sample[k]) * (x[k] - sample[k]);
    }
    if (squared >= nearest[k_ - 1].squared_distance) continue;
    int place = k_ - 1;
    while (place > 0 && nearest[place - 1].squared_distance > squared) {
      nearest[place] = nearest[place - 1];
      --place;
    }
    nearest[place] = {squared, i};
  }
  return nearest[k_ - 1];
}

double NeighbourEstimate::Decision(std::span<const double> x) const noexcept {
  if (!Fits(x, state_dim())) return kOutside;
  return radius_ - std::sqrt(Nearest(x.data(), -1).squared_distance);
}

double NeighbourEstimate::Gradient(std::span<const double> x,
                                   std::span<double> gradient) const noexcept {
  std::fill(gradient.begin(), gradient.end(), 0.0);
  if (!Fits(x, state_dim()) || gradient.size() != x.size()) return kOutside;
  const Neighbour nearest = Nearest(x.data(), -1);
  const double distance = std::sqrt(nearest.squared_distance);
  if (distance > 0.0) {
    for (std::size_t k = 0; k < x.size(); ++k) {
      gradient[k] = (samples_(nearest.sample, static_cast<Eigen::Index>(k)) - x[k]) / distance;
    }
  }
  return radius_ - distance;
}

EstimatePerStep EstimatePerStep::Fit(std::span<const core::Matrix> demonstrations,
                                     const EstimateFitter& fit, int num_steps) {
  DFR_THROW_UNLESS(num_steps >= 0, "num_steps must not be negative: " << num_steps);
  const std::vector<internal::StatesView> views = internal::Views(demonstrations);
  internal::CheckDemonstrations(views);
  if (num_steps == 0) num_steps = internal::LongestLength(views);
  EstimatePerStep result;
  for (int t = 0; t < num_steps; ++t) {
    result.estimates_.push_back(fit(internal::StatesAt(views, t)));
    DFR_THROW_UNLESS(result.estimates_.back() != nullptr &&
                         result.estimates_.back()->state_dim() == demonstrations[0].cols(),
                     "the fit of time step " << t << " returned no estimate of these states");
  }
  return result;
}

const SupportEstimate& EstimatePerStep::at(int t) const noexcept {
  return *estimates_[static_cast<std::size_t>(std::clamp(t, 0, num_steps() - 1))];
}

}  // namespace dfr::kernel
