#include "dfr/core/numerics/local_scatter.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <span>
#include <tuple>
#include <utility>
#include <vector>

#include "dfr/core/contract.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/random.h"

namespace dfr::core {
namespace {

constexpr Eigen::Index kFewest = 4;
constexpr Eigen::Index kMost = 128;
// Eigenvalues of a correlation matrix up to this value are rounding errors.
constexpr double kLeast = 1e-9;
// A coordinate is constant if its standard deviation is at most this fraction of its largest value.
// The rounding of its mean causes such a deviation.
constexpr double kRelativeRounding = 1e-12;

Matrix Thinned(const Matrix& points) {
  if (points.rows() <= kMost) return points;
  Matrix thinned(kMost, points.cols());
  for (Eigen::Index i = 0; i < kMost; ++i) thinned.row(i) = points.row(i * points.rows() / kMost);
  return thinned;
}

// Returns the mean of (x_i - x_j)(x_i - x_j)' / 2. Neighbours are chosen in the coordinates `map`
// x.
Matrix Scatter(const Matrix& points, const Matrix& map, const LocalScatterOptions& options) {
  const Eigen::Index count = points.rows();
  const auto neighbours = std::clamp<Eigen::Index>(
      std::lround(options.neighbours * static_cast<double>(count)), 1, count - 1);
  const auto kept =
      std::clamp<Eigen::Index>(std::lround(options.kept * static_cast<double>(count)), 2, count);
  const Matrix centred = points.rowwise() - points.colwise().mean();
  const Matrix mapped = centred * map.transpose();
  const Eigen::VectorXd square = mapped.rowwise().squaredNorm();
  Eigen::MatrixXd distance = mapped * mapped.transpose();
  distance *= -2.0;
  distance.colwise() += square;
  distance.rowwise() += square.transpose();

  // Pairs of distance and index. The index breaks ties the same way on every machine.
  std::vector<std::pair<double, int>> others(static_cast<std::size_t>(count - 1));
  std::vector<std::vector<int>> nearest(static_cast<std::size_t>(count));
  std::vector<std::pair<double, int>> spread;
  for (Eigen::Index i = 0; i < count; ++i) {
    for (Eigen::Index j = 0; j + 1 < count; ++j) {
      const Eigen::Index other = j < i ? j : j + 1;
      others[static_cast<std::size_t>(j)] = {distance(other, i), static_cast<int>(other)};
    }
    std::nth_element(others.begin(), others.begin() + neighbours - 1, others.end());
    // Ranks points by the sum of distances. The maximum would be equal for points that are each
    // other's farthest neighbour.
    double sum = 0.0;
    std::vector<int>& chosen = nearest[static_cast<std::size_t>(i)];
    chosen.reserve(static_cast<std::size_t>(neighbours));
    for (const auto& [far, j] : std::span(others).first(static_cast<std::size_t>(neighbours))) {
      sum += far;
      chosen.push_back(j);
    }
    spread.emplace_back(sum, static_cast<int>(i));
  }
  std::nth_element(spread.begin(), spread.begin() + kept - 1, spread.end());
  Matrix sum = Matrix::Zero(points.cols(), points.cols());
  Eigen::RowVectorXd difference(points.cols());
  for (Eigen::Index k = 0; k < kept; ++k) {
    const int i = spread[static_cast<std::size_t>(k)].second;
    for (const int j : nearest[static_cast<std::size_t>(i)]) {
      difference = points.row(i) - points.row(j);
      sum.noalias() += 0.5 * difference.transpose() * difference;
    }
  }
  return sum / static_cast<double>(kept * neighbours);
}

// Returns the mean variance that Scatter() gives for `count` standard normal points in n
// dimensions.
double ComputeNormalScatter(Eigen::Index count, Eigen::Index n,
                            const LocalScatterOptions& options) {
  constexpr int kDraws = 4;
  Random random(1);
  const Matrix identity = Matrix::Identity(n, n);
  double trace = 0.0;
  Matrix points(count, n);
  for (int draw = 0; draw < kDraws; ++draw) {
    for (double& x : points.reshaped()) x = random.Normal();
    trace += Scatter(points, identity, options).trace();
  }
  return trace / static_cast<double>(kDraws * n);
}

// Cached per thread, because a fit requests the same value at every time step. The cache is
// bounded: `count` is at most kMost, and `n` at most the number of selected features.
double NormalScatter(Eigen::Index count, Eigen::Index n, const LocalScatterOptions& options) {
  thread_local std::map<std::tuple<Eigen::Index, Eigen::Index, double, double>, double> known;
  const auto [at, is_new] = known.try_emplace({count, n, options.neighbours, options.kept}, 0.0);
  if (is_new) at->second = ComputeNormalScatter(count, n, options);
  return at->second;
}

Matrix InverseSquareRoot(const SymmetricEigen& eigen, double ridge) {
  DFR_THROW_UNLESS(ridge > 0.0, "the ridge must be positive, not " << ridge);
  const Eigen::VectorXd scale = (eigen.values.array().max(0.0) + ridge).rsqrt();
  const Eigen::MatrixXd scaled = eigen.vectors * scale.asDiagonal();
  return scaled * eigen.vectors.transpose();
}

}  // namespace

Matrix LocalScatter(std::span<const Matrix> groups, const LocalScatterOptions& options) {
  DFR_THROW_UNLESS(options.neighbours > 0.0 && options.neighbours < 1.0,
                   "neighbours must lie in (0, 1), not " << options.neighbours);
  DFR_THROW_UNLESS(options.kept > 0.0 && options.kept <= 1.0,
                   "kept must lie in (0, 1], not " << options.kept);
  DFR_THROW_UNLESS(options.rounds > 0, "rounds must be positive, not " << options.rounds);
  Matrix global = PooledCovariance(groups);
  const Eigen::Index n = global.rows();
  std::vector<Matrix> points;
  for (const Matrix& group : groups) {
    if (group.rows() >= kFewest) points.push_back(Thinned(group));
  }
  if (points.empty()) return global;

  const Matrix least = 0.0025 * global.diagonal().asDiagonal().toDenseMatrix();
  Eigen::Index dimensions = 0;
  Matrix scatter = global;
  for (int round = 0; round < options.rounds; ++round) {
    Eigen::VectorXd inverse_sd = scatter.diagonal().cwiseSqrt();
    for (double& s : inverse_sd) s = s > 0.0 ? 1.0 / s : 0.0;
    const Matrix scaled = inverse_sd.asDiagonal() * scatter * inverse_sd.asDiagonal();
    const SymmetricEigen eigen = DecomposeSymmetric(scaled);
    // Neither a constant coordinate nor a linear combination of others counts as a dimension.
    if (round == 0) dimensions = std::max<Eigen::Index>(1, (eigen.values.array() > kLeast).count());
    const Matrix map = InverseSquareRoot(eigen, options.ridge) * inverse_sd.asDiagonal();
    scatter = Matrix::Zero(n, n);
    Eigen::Index count = 0;
    for (const Matrix& group : points) {
      scatter += static_cast<double>(group.rows()) /
                 NormalScatter(group.rows(), dimensions, options) * Scatter(group, map, options);
      count += group.rows();
    }
    scatter = scatter / static_cast<double>(count) + least;
  }
  // Removes the rounding errors of constant entries.
  for (Eigen::Index i = 0; i < n; ++i) {
    if (global(i, i) > 0.0) continue;
    scatter.row(i).setZero();
    scatter.col(i).setZero();
  }
  return scatter;
}

Matrix PooledCovariance(std::span<const Matrix> groups) {
  DFR_THROW_UNLESS(!groups.empty(), "there are no points");
  const Eigen::Index n = groups[0].cols();
  Matrix covariance = Matrix::Zero(n, n);
  Eigen::Index count = 0;
  for (const Matrix& group : groups) {
    DFR_THROW_UNLESS(group.cols() == n,
                     "points have " << group.cols() << " entries, but others have " << n);
    if (group.rows() == 0) continue;
    const Matrix centred = group.rowwise() - group.colwise().mean();
    covariance += centred.transpose() * centred;
    count += group.rows();
  }
  DFR_THROW_UNLESS(count > 0, "there are no points");
  covariance /= static_cast<double>(count);
  for (Eigen::Index i = 0; i < n; ++i) {
    double most = 0.0;
    for (const Matrix& group : groups) {
      if (group.rows() > 0) most = std::max(most, group.col(i).cwiseAbs().maxCoeff());
    }
    if (std::sqrt(covariance(i, i)) <= kRelativeRounding * most) {
      covariance.row(i).setZero();
      covariance.col(i).setZero();
    }
  }
  return covariance;
}

Matrix InverseSquareRoot(const Matrix& covariance, double ridge) {
  return InverseSquareRoot(DecomposeSymmetric(covariance), ridge);
}

}  // namespace dfr::core
