#include "dfr/kernel/whitened_support.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/folds.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/numerics/local_scatter.h"
#include "dfr/core/numerics/spanning_tree.h"
#include "dfr/core/random.h"

namespace dfr::kernel {
namespace {

// Largest asymmetry of a symmetric map, relative to its largest entry.
constexpr double kMapRounding = 1e-9;
constexpr double kOutOfReach = -std::numeric_limits<double>::infinity();

using Buffer = std::array<double, WhitenedSupport::kMaxFeatures>;

// Time steps whose states are pooled.
struct Window {
  int first;
  int last;
  int stride;
  bool hold;  // True if an ended demonstration counts once with its last state.
};

core::Matrix Pool(std::span<const core::Matrix> demonstrations, const Window& window) {
  std::vector<std::pair<const core::Matrix*, Eigen::Index>> rows;
  for (const core::Matrix& states : demonstrations) {
    const Eigen::Index end = std::min<Eigen::Index>(window.last + 1, states.rows());
    for (Eigen::Index i = window.first; i < end; i += window.stride) rows.emplace_back(&states, i);
    if (end <= window.first && window.hold) rows.emplace_back(&states, states.rows() - 1);
  }
  core::Matrix pool(static_cast<Eigen::Index>(rows.size()), demonstrations[0].cols());
  for (Eigen::Index i = 0; i < pool.rows(); ++i) {
    const auto& [states, row] = rows[static_cast<std::size_t>(i)];
    pool.row(i) = states->row(row);
  }
  return pool;
}

// Returns the sum of two covariances of the pooled states: the covariance of the demonstrations'
// means about neighbouring means, and the covariance of each demonstration's states about their
// mean.
core::Matrix LocalCovariance(std::span<const core::Matrix> demonstrations, const Window& window) {
  core::Matrix means(std::ssize(demonstrations), demonstrations[0].cols());
  Eigen::Index rows = 0;
  std::vector<core::Matrix> own;
  for (const core::Matrix& states : demonstrations) {
    const core::Matrix here = Pool({&states, 1}, window);
    if (here.rows() == 0) continue;
    means.row(rows++) = here.colwise().mean();
    own.push_back(here);
  }
  means.conservativeResize(rows, Eigen::NoChange);
  return core::LocalScatter({&means, 1}, {.rounds = 1}) + core::PooledCovariance(own);
}

Window WindowAt(int t, int num_steps, const WhitenedSupportOptions& options) {
  const int stride = options.Stride(num_steps);
  return {.first = t - stride * std::min(options.window, t / stride),
          .last = t + stride * options.window,
          .stride = stride,
          .hold = options.hold_ended};
}

// Returns V_t, a symmetric matrix. `states` are the pooled states of the window.
core::Matrix MapOf(std::span<const core::Matrix> demonstrations, const core::Matrix& states,
                   const Window& window, const WhitenedSupportOptions& options) {
  if (!options.phase_whitening) return core::Matrix::Identity(states.cols(), states.cols());
  return core::InverseSquareRoot(options.local ? LocalCovariance(demonstrations, window)
                                               : core::PooledCovariance({&states, 1}),
                                 options.phase_ridge);
}

// Returns the number of time steps reached by at least the fraction `share` of the demonstrations
// and by at least two of them.
int NumSteps(std::span<const core::Matrix> demonstrations, double share) {
  std::vector<Eigen::Index> lengths;
  for (const core::Matrix& states : demonstrations) lengths.push_back(states.rows());
  std::sort(lengths.begin(), lengths.end(), std::greater<>());
  const auto least =
      static_cast<std::size_t>(std::ceil(share * static_cast<double>(lengths.size())));
  return static_cast<int>(lengths[std::clamp<std::size_t>(least, 2, lengths.size()) - 1]);
}

}  // namespace

int WhitenedSupportOptions::Stride(int num_steps) const noexcept {
  return std::max(1, static_cast<int>(window_share * num_steps) / std::max(1, window));
}

WhitenedSupport WhitenedSupport::Fit(std::span<const core::Matrix> demonstrations,
                                     const WhitenedSupportOptions& options) {
  DFR_THROW_UNLESS(demonstrations.size() >= 2,
                   "a support per time step needs at least 2 "
                   "demonstrations, not "
                       << demonstrations.size());
  DFR_THROW_UNLESS(options.window >= 0, "window must not be negative: " << options.window);
  DFR_THROW_UNLESS(options.every >= 1, "every must be at least 1, not " << options.every);
  DFR_THROW_UNLESS(options.window_share >= 0.0 && options.window_share <= 1.0,
                   "window_share must lie in [0, 1], not " << options.window_share);
  DFR_THROW_UNLESS(options.least_share >= 0.0 && options.least_share <= 1.0,
                   "least_share must lie in [0, 1], not " << options.least_share);
  const Eigen::Index n = demonstrations[0].cols();
  DFR_THROW_UNLESS(n >= 1 && n <= kMaxFeatures,
                   "1 to " << kMaxFeatures << " features are supported, not " << n);
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    DFR_THROW_UNLESS(demonstrations[d].cols() == n && demonstrations[d].rows() >= 1,
                     "demonstration " << d << " is " << demonstrations[d].rows() << " x "
                                      << demonstrations[d].cols()
                                      << "; it must have at least one row and " << n << " columns");
    DFR_THROW_UNLESS(demonstrations[d].allFinite(),
                     "demonstration " << d << " has a non-finite entry");
  }
  const int num_steps = NumSteps(demonstrations, options.least_share);
  std::vector<Estimate> estimates;
  for (int t = 0; t < num_steps; t += options.every) {
    const Window window = WindowAt(t, num_steps, options);
    const core::Matrix states = Pool(demonstrations, window);
    const core::Matrix map = MapOf(demonstrations, states, window, options);
    // The map is symmetric.
    FitSummary summary;
    const OneClassSvm svm = OneClassSvm::Fit(states * map, options.svm, &summary);
    estimates.push_back({map, options.single_precision ? svm.InSinglePrecision() : svm});
    if (summary.reason == FitSummary::Reason::kInterrupted) break;
    // Reports progress here too: with many features, a map takes longer than an estimate.
    if (options.svm.progress &&
        !options.svm.progress({summary.iterations, summary.kkt_gap, options.svm.tolerance})) {
      break;
    }
  }
  return WhitenedSupport(std::move(estimates));
}

WhitenedSupport::WhitenedSupport(std::vector<Estimate> estimates) {
  DFR_THROW_UNLESS(!estimates.empty(), "a support needs at least one estimate");
  const Eigen::Index n = estimates[0].map.rows();
  DFR_THROW_UNLESS(n >= 1 && n <= kMaxFeatures,
                   "1 to " << kMaxFeatures << " features are supported, not " << n);
  for (std::size_t t = 0; t < estimates.size(); ++t) {
    Estimate& estimate = estimates[t];
    DFR_THROW_UNLESS(estimate.map.rows() == n && estimate.map.cols() == n &&
                         estimate.svm.state_dim() == n && estimate.map.allFinite(),
                     "estimate " << t << ": its map must be " << n << " x " << n
                                 << " and finite, and its states must have " << n << " entries");
    const double largest = estimate.map.cwiseAbs().maxCoeff();
    const core::Matrix skew = estimate.map - estimate.map.transpose();
    DFR_THROW_UNLESS(skew.cwiseAbs().maxCoeff() <= kMapRounding * largest,
                     "estimate " << t << ": its map must be symmetric");
    const double norm = core::OperatorNorm(estimate.map);
    phases_.push_back({std::move(estimate.map), norm, std::move(estimate.svm)});
  }
}

const WhitenedSupport::Phase& WhitenedSupport::at(int t) const noexcept {
  return phases_[static_cast<std::size_t>(std::clamp(t, 0, num_steps() - 1))];
}

int WhitenedSupport::state_dim() const noexcept { return static_cast<int>(phases_[0].map.cols()); }

int WhitenedSupport::num_steps() const noexcept { return static_cast<int>(phases_.size()); }

double WhitenedSupport::Decision(int t, std::span<const double> z) const noexcept {
  if (static_cast<int>(z.size()) != state_dim()) return kOutOfReach;
  Buffer buffer;
  const std::span<double> y(buffer.data(), z.size());
  core::AsVector(y).noalias() = at(t).map.lazyProduct(core::AsVector(z));
  return at(t).svm.Decision(y);
}

double WhitenedSupport::Gradient(int t, std::span<const double> z,
                                 std::span<double> gradient) const noexcept {
  std::fill(gradient.begin(), gradient.end(), 0.0);
  if (static_cast<int>(z.size()) != state_dim() || gradient.size() != z.size()) return kOutOfReach;
  Buffer buffer;
  Buffer inner_buffer;
  const std::span<double> y(buffer.data(), z.size());
  const std::span<double> inner(inner_buffer.data(), z.size());
  const Phase& phase = at(t);
  core::AsVector(y).noalias() = phase.map.lazyProduct(core::AsVector(z));
  const double g = phase.svm.Gradient(y, inner);
  core::AsVector(gradient).noalias() = phase.map.lazyProduct(core::AsVector(inner));
  return g;
}

double WhitenedSupport::LogDecision(int t, std::span<const double> z,
                                    std::span<double> gradient) const noexcept {
  std::fill(gradient.begin(), gradient.end(), 0.0);
  if (static_cast<int>(z.size()) != state_dim()) return kOutOfReach;
  if (!gradient.empty() && gradient.size() != z.size()) return kOutOfReach;
  Buffer buffer;
  Buffer inner_buffer;
  const std::span<double> y(buffer.data(), z.size());
  const Phase& phase = at(t);
  core::AsVector(y).noalias() = phase.map.lazyProduct(core::AsVector(z));
  if (gradient.empty()) return phase.svm.LogDecision(y);
  const std::span<double> inner(inner_buffer.data(), z.size());
  const double l = phase.svm.LogGradient(y, inner);
  core::AsVector(gradient).noalias() = phase.map.lazyProduct(core::AsVector(inner));
  return l;
}

double WhitenedSupport::FromLog(int t, double l) const noexcept { return at(t).svm.FromLog(l); }

double WhitenedSupport::curvature_bound(int t) const noexcept {
  return at(t).svm.gamma() * at(t).norm * at(t).norm;
}

namespace {

// Returns the distance to the nearest demonstrated state of any time step, in the coordinates `map`
// z.
double Nearest(std::span<const core::Matrix> demonstrations, const core::Matrix& map,
               const Eigen::VectorXd& z) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const core::Matrix& states : demonstrations) {
    const core::Matrix differences = (states.rowwise() - z.transpose()) * map.transpose();
    nearest = std::min(nearest, differences.rowwise().squaredNorm().minCoeff());
  }
  return std::sqrt(nearest);
}

}  // namespace

ModeSeparationTest TestModeSeparation(const WhitenedSupport& support,
                                      std::span<const core::Matrix> demonstrations) {
  constexpr double kLeastShare = 0.1;
  // Minimum distance between clusters, in standard deviations of states about their neighbours: two
  // on either side.
  constexpr double kLeastWidth = 4.0;
  const Eigen::Index n = support.state_dim();
  ModeSeparationTest test{.steps = support.num_steps()};
  for (int t = 0; t < support.num_steps(); ++t) {
    core::Matrix states(std::ssize(demonstrations), n);
    Eigen::Index rows = 0;
    for (const core::Matrix& demonstration : demonstrations) {
      DFR_THROW_UNLESS(demonstration.cols() == n,
                       "demonstrations have " << demonstration.cols() << " features, not " << n);
      if (t < demonstration.rows()) states.row(rows++) = demonstration.row(t);
    }
    states.conservativeResize(rows, Eigen::NoChange);
    const std::vector<core::Link> links = core::SpanningTree(states * support.map(t).transpose());
    const double longest = std::max(kLeastWidth, core::kClusterGap * core::LinkMedian(links));
    const double least = std::max(3.0, kLeastShare * static_cast<double>(rows));
    for (const core::Link& link : links) {
      const auto members = static_cast<double>(link.members);
      if (link.length <= longest || members < least ||
          static_cast<double>(rows) - members < least) {
        continue;
      }
      const Eigen::VectorXd middle = 0.5 * (states.row(static_cast<Eigen::Index>(link.from)) +
                                            states.row(static_cast<Eigen::Index>(link.to)));
      // A demonstration that passes this point at another time shows that the point is not in a
      // gap.
      if (Nearest(demonstrations, support.map(t), middle) < 0.25 * link.length) continue;
      test.inside += support.LogDecision(t, core::AsSpan(middle), {}) >= 0.0 ? 1 : 0;
      ++test.points;
    }
  }
  return test;
}

double LogVolumeRatio(const WhitenedSupport& wide, double wide_level, const WhitenedSupport& narrow,
                      double narrow_level, std::span<const core::Matrix> demonstrations) {
  constexpr std::size_t kLeastDemonstrations = 5;
  constexpr std::size_t kDraws = 400;
  constexpr int kLeastInside = 10;
  constexpr double kSpread = 1.5;  // Standard deviation of random points about the states.
  constexpr std::uint64_t kSeed = 0x766f6c;
  core::Random random(kSeed);
  double sum = 0.0;
  int steps = 0;
  for (int t = 0; t < wide.num_steps(); ++t) {
    const core::Matrix& map = wide.map(t);
    std::vector<Eigen::VectorXd> states;
    for (const core::Matrix& demonstration : demonstrations) {
      if (t < demonstration.rows()) states.emplace_back(map * demonstration.row(t).transpose());
    }
    if (states.size() < kLeastDemonstrations) continue;
    double wide_volume = 0.0;
    double narrow_volume = 0.0;
    int inside = 0;
    for (std::size_t draw = 0; draw < kDraws; ++draw) {
      Eigen::VectorXd y = states[draw % states.size()];
      for (double& entry : y) entry += kSpread * random.Normal();
      const bool in_wide = wide.estimate(t).LogDecision(core::AsSpan(y)) >= wide_level;
      const bool in_narrow = narrow.estimate(t).LogDecision(core::AsSpan(y)) >= narrow_level;
      if (!in_wide && !in_narrow) continue;  // true for most points
      double density = 0.0;
      for (const Eigen::VectorXd& state : states) {
        density += std::exp(-(y - state).squaredNorm() / (2.0 * kSpread * kSpread));
      }
      if (in_wide) wide_volume += 1.0 / density;
      if (!in_narrow) continue;
      narrow_volume += 1.0 / density;
      ++inside;
    }
    if (inside < kLeastInside || wide_volume == 0.0) continue;
    sum += std::log(narrow_volume / wide_volume);
    ++steps;
  }
  return steps > 0 ? sum / steps : 0.0;
}

}  // namespace dfr::kernel
