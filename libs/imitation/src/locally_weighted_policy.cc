#include "dfr/imitation/locally_weighted_policy.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::imitation {

LocallyWeightedPolicy::LocallyWeightedPolicy(core::FeatureTransform features,
                                             std::span<const core::Trajectory> demonstrations,
                                             const LocallyWeightedOptions& options)
    : features_(std::move(features)), options_(options) {
  DFR_THROW_UNLESS(options.window >= 0, "window must not be negative: " << options.window);
  DFR_THROW_UNLESS(options.width > 0.0, "width must be positive, not " << options.width);
  DFR_THROW_UNLESS(options.ridge > 0.0, "ridge must be positive, not " << options.ridge);
  DFR_THROW_UNLESS(options.max_per_step > 0,
                   "max_per_step must be positive, not " << options.max_per_step);
  DFR_THROW_UNLESS(!demonstrations.empty(), "there are no demonstrations");
  const int n = features_.num_features();
  const Eigen::Index m = demonstrations[0].controls.cols();
  DFR_THROW_UNLESS(n <= kMaxFeatures,
                   "at most " << kMaxFeatures << " features are supported, not " << n);
  DFR_THROW_UNLESS(m >= 1 && m <= kMaxControls,
                   "1 to " << kMaxControls << " control entries are supported, not " << m);
  std::vector<core::Matrix> points;
  std::vector<const core::Matrix*> controls;
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    const core::Trajectory& demonstration = demonstrations[d];
    DFR_THROW_UNLESS(demonstration.controls.cols() == m &&
                         demonstration.states.rows() == demonstration.controls.rows() + 1,
                     "demonstration " << d
                                      << " must have controls of the size of demonstration 0, and "
                                         "one state more than controls");
    points.push_back(features_.Apply(demonstration.states));
    controls.push_back(&demonstration.controls);
  }
  auto [chosen, begin] = core::SelectControls(controls, options.max_per_step);
  begin_ = std::move(begin);
  DFR_THROW_UNLESS(!chosen.empty(), "all demonstrated controls are zero");
  points_.resize(static_cast<Eigen::Index>(chosen.size()), n);
  controls_.resize(points_.rows(), m);
  for (Eigen::Index row = 0; row < points_.rows(); ++row) {
    const auto [d, t] = chosen[static_cast<std::size_t>(row)];
    points_.row(row) = points[d].row(t);
    controls_.row(row) = demonstrations[d].controls.row(t);
  }
}

void LocallyWeightedPolicy::Control(int t, std::span<const double> x,
                                    std::span<double> u) const noexcept {
  using Square =
      Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxFeatures + 1, kMaxFeatures + 1>;
  using Right =
      Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMaxFeatures + 1, kMaxControls>;
  using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMaxFeatures + 1, 1>;
  constexpr double kLeastExponent = -13.815510557964274;  // Weights below 1e-6 do not count.
  if (static_cast<int>(x.size()) != state_dim() || !core::AllFinite(x)) {
    std::ranges::fill(u, std::numeric_limits<double>::quiet_NaN());
    return;
  }
  const int n = features_.num_features();
  std::array<double, kMaxFeatures> buffer;
  const std::span<double> z(buffer.data(), static_cast<std::size_t>(n));
  features_.Apply(x, z);

  const int steps = static_cast<int>(begin_.size()) - 1;
  // Beyond the last time step, the last pairs still apply.
  const int here = std::clamp(t, 0, steps - 1);
  const auto begin = [&](int step) {
    return begin_[static_cast<std::size_t>(std::clamp(step, 0, steps))];
  };
  // If all demonstrations rest in the window, the window grows to the nearest step with a motion.
  int window = options_.window;
  while (begin(here - window) == begin(here + window + 1)) ++window;
  const int first = begin(here - window);
  const int last = begin(here + window + 1);
  // Uses distances relative to the nearest pair. Far from all demonstrations, the nearest pairs
  // then decide; all weights would underflow otherwise.
  double nearest = std::numeric_limits<double>::infinity();
  for (int row = first; row < last; ++row) {
    nearest = std::min(nearest, (points_.row(row).transpose() - core::AsVector(z)).squaredNorm());
  }
  Square a = Square::Zero(n + 1, n + 1);
  Right b = Right::Zero(n + 1, controls_.cols());
  a.diagonal().tail(n).setConstant(options_.ridge);
  a(0, 0) = 1e-9;
  Vector point(n + 1);
  point[0] = 1.0;
  for (int row = first; row < last; ++row) {
    point.tail(n) = points_.row(row).transpose() - core::AsVector(z);
    const double exponent =
        -0.5 * (point.tail(n).squaredNorm() - nearest) / (options_.width * options_.width);
    if (exponent < kLeastExponent) continue;
    const double weight = std::exp(exponent);
    a.noalias() += weight * point.lazyProduct(point.transpose());
    b.noalias() += weight * point.lazyProduct(controls_.row(row));
  }
  const Eigen::LLT<Square> cholesky(a);
  cholesky.solveInPlace(b);
  for (std::size_t i = 0; i < u.size(); ++i) {
    u[i] = std::clamp(b(0, static_cast<Eigen::Index>(i)), -1.0, 1.0);
  }
}

double CrossValidatedWidth(const core::FeatureTransform& features,
                           std::span<const core::Trajectory> demonstrations,
                           const LocallyWeightedOptions& options) {
  constexpr std::array kWidths = {0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0};
  constexpr std::size_t kMostFolds = 5;
  DFR_THROW_UNLESS(
      demonstrations.size() >= 2,
      "a width by cross-validation needs two demonstrations, not " << demonstrations.size());
  LocallyWeightedOptions tried = options;
  tried.width = kWidths[0];
  (void)LocallyWeightedPolicy(features, demonstrations, tried);  // checks all demonstrations
  const std::size_t folds = std::min(kMostFolds, demonstrations.size());
  std::array<double, kWidths.size()> errors{};
  for (std::size_t fold = 0; fold < folds; ++fold) {
    std::vector<core::Trajectory> others;
    for (std::size_t d = 0; d < demonstrations.size(); ++d) {
      if (d % folds != fold) others.push_back(demonstrations[d]);
    }
    Eigen::VectorXd u(demonstrations[0].controls.cols());
    for (std::size_t i = 0; i < kWidths.size(); ++i) {
      tried.width = kWidths[i];
      const LocallyWeightedPolicy policy(features, others, tried);
      for (std::size_t d = fold; d < demonstrations.size(); d += folds) {
        const core::Matrix& controls = demonstrations[d].controls;
        for (Eigen::Index t = 0; t < controls.rows(); ++t) {
          if (controls.row(t).squaredNorm() == 0.0) continue;  // padding
          policy.Control(static_cast<int>(t), core::Row(demonstrations[d].states, t),
                         core::AsSpan(u));
          errors[i] += (u - controls.row(t).transpose()).squaredNorm();
        }
      }
    }
  }
  const auto best = std::ranges::min_element(errors) - errors.begin();
  return kWidths[static_cast<std::size_t>(best)];
}

}  // namespace dfr::imitation
