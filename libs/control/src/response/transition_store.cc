#include "dfr/control/response/transition_store.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "dfr/control/constants.h"
#include "dfr/core/contract.h"
#include "dfr/core/trajectory.h"
#include "transition_sums.h"

namespace dfr::control {
namespace {

// Maximum number of transitions per estimate.
constexpr int kMaxTransitions = 1024;
int RoundUp(int value, std::size_t multiple) {
  const int m = static_cast<int>(multiple);
  return (value + m - 1) / m * m;
}

// Maximum number of features and of control entries. The time of a decision grows with both.
constexpr int kMaxEntries = 256;

void Check(const ResponseOptions& options) {
  DFR_THROW_UNLESS(options.ridge > 0.0 && std::isfinite(options.ridge),
                   "ridge must be positive and finite, not " << options.ridge);
  DFR_THROW_UNLESS(options.drift_ridge > 0.0 && std::isfinite(options.drift_ridge),
                   "drift_ridge must be positive and finite, not " << options.drift_ridge);
  DFR_THROW_UNLESS(options.slope_ridge > 0.0 && std::isfinite(options.slope_ridge),
                   "slope_ridge must be positive and finite, not " << options.slope_ridge);
  DFR_THROW_UNLESS(options.prior_weight >= 0.0 && std::isfinite(options.prior_weight),
                   "prior_weight must be finite and not negative: " << options.prior_weight);
  DFR_THROW_UNLESS(options.window >= 0, "window must not be negative: " << options.window);
  DFR_THROW_UNLESS(options.max_per_step > 0,
                   "max_per_step must be positive, not " << options.max_per_step);
  DFR_THROW_UNLESS(options.window < kMaxTransitions &&
                       options.max_per_step <= kMaxTransitions / (2 * options.window + 1),
                   "(2 window + 1) max_per_step must be at most "
                       << kMaxTransitions << "; window is " << options.window << ", max_per_step "
                       << options.max_per_step);
  DFR_THROW_UNLESS(options.forgetting >= 0.0 && options.forgetting < 1.0,
                   "forgetting must lie in [0, 1), not " << options.forgetting);
}

}  // namespace

TransitionStore::TransitionStore(std::span<const core::Matrix> features,
                                 std::span<const core::Matrix> controls,
                                 const ResponseOptions& options,
                                 std::span<const core::Matrix> contexts)
    : options_(options) {
  Check(options);
  DFR_THROW_UNLESS(!features.empty() && features.size() == controls.size(),
                   "features of " << features.size() << " demonstrations and controls of "
                                  << controls.size() << ": the numbers must be equal and positive");
  feature_dim_ = static_cast<int>(features[0].cols());
  control_dim_ = static_cast<int>(controls[0].cols());
  const int n = feature_dim_;
  const int m = control_dim_;
  DFR_THROW_UNLESS(n >= 1 && n <= kMaxEntries && m >= 1 && m <= kMaxEntries,
                   "features have " << n << " entries and controls " << m << "; 1 to "
                                    << kMaxEntries << " are supported");
  for (std::size_t d = 0; d < features.size(); ++d) {
    DFR_THROW_UNLESS(features[d].cols() == n && controls[d].cols() == m &&
                         features[d].rows() == controls[d].rows() + 1,
                     "demonstration " << d << " has features " << features[d].rows() << " x "
                                      << features[d].cols() << " and controls "
                                      << controls[d].rows() << " x " << controls[d].cols()
                                      << "; (T + 1) x " << n << " and T x " << m << " are needed");
    DFR_THROW_UNLESS(contexts.empty() || (contexts.size() == controls.size() &&
                                          contexts[d].cols() == contexts[0].cols() &&
                                          contexts[d].rows() >= controls[d].rows()),
                     "demonstration "
                         << d
                         << " needs one context per control; all contexts must have the same size");
  }

  std::vector<const core::Matrix*> pointers;
  for (const core::Matrix& matrix : controls) pointers.push_back(&matrix);
  auto [chosen, begin] = core::SelectControls(pointers, options.max_per_step);
  begin_ = std::move(begin);

  transitions_.setZero(static_cast<Eigen::Index>(chosen.size()), Width());
  contexts_.setZero(transitions_.rows(), contexts.empty() ? 0 : contexts[0].cols());
  for (Eigen::Index row = 0; row < transitions_.rows(); ++row) {
    const auto [d, t] = chosen[static_cast<std::size_t>(row)];
    transitions_.row(row).head(2 * n + 1 + m) << features[d].row(t).cast<float>(), 1.0F,
        controls[d].row(t).cast<float>(),
        (features[d].row(t + 1) - features[d].row(t)).cast<float>();
    if (!contexts.empty()) contexts_.row(row) = contexts[d].row(t).cast<float>();
  }
  Finish();
}

int TransitionStore::Width() const noexcept {
  // The controls of a row are read in steps of kWidth.
  const int controls = feature_dim_ + 1 + RoundUp(control_dim_, internal::kWidth);
  return RoundUp(std::max(2 * feature_dim_ + 1 + control_dim_, controls), internal::kWidth);
}

void TransitionStore::Finish() {
  points_.setZero(transitions_.rows() + Eigen::Index{internal::kPadding}, feature_dim_);
  points_.topRows(transitions_.rows()) = transitions_.leftCols(feature_dim_);
  const core::Matrix from = transitions_.leftCols(feature_dim_).cast<double>();
  const core::Matrix changes =
      transitions_.middleCols(feature_dim_ + 1 + control_dim_, feature_dim_).cast<double>();
  const core::Matrix to = from + changes;
  if (changes.rows() > 0) {
    mean_square_change_ = changes.squaredNorm() / static_cast<double>(changes.rows());
  }
  lowest_ = highest_ = Eigen::VectorXd::Zero(feature_dim_);
  if (from.rows() > 0) {
    lowest_ = from.colwise().minCoeff().cwiseMin(to.colwise().minCoeff());
    highest_ = from.colwise().maxCoeff().cwiseMax(to.colwise().maxCoeff());
  }
  const double diagonal = (highest_ - lowest_).norm();
  lowest_.array() -= diagonal;
  highest_.array() += diagonal;
  for (int t = 0; t + 1 < static_cast<int>(begin_.size()); ++t) {
    const auto [first, last] = Near(t);
    largest_ = std::max(largest_, last - first);
  }
}

void TransitionStore::Save(core::ArchiveWriter& archive) const {
  archive.Number(options_.ridge);
  archive.Number(options_.prior_weight);
  archive.Integer(options_.window);
  archive.Integer(options_.max_per_step);
  archive.Number(options_.forgetting);
  archive.Number(options_.drift_ridge);
  archive.Number(options_.slope_ridge);
  archive.Integer(options_.measured_changes ? 1 : 0);
  archive.Integer(feature_dim_);
  archive.Integer(control_dim_);
  archive.Integers(begin_);
  archive.MatrixBlock(transitions_.leftCols(2 * feature_dim_ + 1 + control_dim_).cast<double>());
  archive.MatrixBlock(contexts_.cast<double>());
}

TransitionStore TransitionStore::Load(core::ArchiveReader& archive) {
  TransitionStore prior;
  try {
    ResponseOptions& options = prior.options_;
    options.ridge = archive.Number();
    options.prior_weight = archive.Number();
    options.window = archive.IntegerIn(0, kMaxTransitions);
    options.max_per_step = archive.IntegerIn(1, kMaxTransitions);
    options.forgetting = archive.Number();
    options.drift_ridge = archive.Number();
    options.slope_ridge = archive.Number();
    options.measured_changes = archive.IntegerIn(0, 1) == 1;
    Check(options);
    prior.feature_dim_ = archive.IntegerIn(1, kMaxEntries);
    prior.control_dim_ = archive.IntegerIn(1, kMaxEntries);
    prior.begin_ = archive.Integers();
    const core::Matrix transitions = archive.MatrixBlock();
    const std::vector<int>& begin = prior.begin_;
    DFR_THROW_UNLESS(
        begin.size() >= 2 && begin.front() == 0 && begin.back() == transitions.rows(),
        "the time steps of the transitions do not begin at row 0 and end at the last row");
    for (std::size_t t = 1; t < begin.size(); ++t) {
      DFR_THROW_UNLESS(begin[t] >= begin[t - 1] && begin[t] - begin[t - 1] <= options.max_per_step,
                       "time step " << t - 1 << " of the transitions has "
                                    << begin[t] - begin[t - 1] << " transitions; 0 to "
                                    << options.max_per_step << " are allowed");
    }
    const Eigen::Index n = prior.feature_dim_;
    DFR_THROW_UNLESS(
        transitions.cols() == 2 * n + 1 + prior.control_dim_,
        "the width of the transitions does not match the numbers of features and control entries");
    prior.transitions_.setZero(transitions.rows(), prior.Width());
    prior.transitions_.leftCols(transitions.cols()) = transitions.cast<float>();
    DFR_THROW_UNLESS(prior.transitions_.allFinite() && (transitions.col(n).array() == 1.0).all(),
                     "the transitions have an invalid entry");
    const core::Matrix contexts = archive.MatrixBlock();
    DFR_THROW_UNLESS(contexts.rows() == transitions.rows() && contexts.cols() <= kMaxEntries &&
                         contexts.allFinite(),
                     "the contexts do not match the transitions");
    prior.contexts_ = contexts.cast<float>();
    prior.Finish();
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
  return prior;
}

std::pair<int, int> TransitionStore::Near(int t) const noexcept {
  const int steps = static_cast<int>(begin_.size()) - 1;
  t = std::min(t, steps - 1);
  const auto begin = [&](int step) {
    return begin_[static_cast<std::size_t>(std::clamp(step, 0, steps))];
  };
  // If all demonstrations rest longer than the window, the window grows until it contains a
  // control.
  int window = options_.window;
  while (begin(t - window) == begin(t + window + 1) && window < steps) ++window;
  return {begin(t - window), begin(t + window + 1)};
}

TransitionStore::Workspace TransitionStore::MakeWorkspace() const {
  Workspace workspace;
  workspace.states = RoundUp(control_dim_, internal::kWidth);
  const int left = workspace.states + RoundUp(feature_dim_ + 1, internal::kWidth);
  constexpr Eigen::Index kPadding{internal::kPadding};
  workspace.distances.setZero(largest_ + kPadding);
  workspace.weights.setZero(kSpread + kPadding);
  workspace.spread.setZero(kSpread + kPadding);
  workspace.nearest.setZero(kNearest + kPadding);
  workspace.near_weights.setZero(kNearest + kPadding);
  workspace.z.setZero(Width());
  workspace.tile.setZero(Eigen::Index{internal::kTile} * (left + Width()));
  workspace.sums.setZero(left, Width());
  workspace.residual.setZero(Width());
  return workspace;
}

bool TransitionStore::Reaches(std::span<const double> z) const noexcept {
  return core::AsVector(z).squaredNorm() <= std::numeric_limits<float>::max() / kSpread;
}

bool TransitionStore::Surrounds(std::span<const double> z) const noexcept {
  const auto at = core::AsVector(z).array();
  return (at >= lowest_.array()).all() && (at <= highest_.array()).all();
}

double TransitionStore::Distance(std::span<const double> z, Workspace& workspace) const noexcept {
  workspace.z.head(feature_dim_) = core::AsVector(z).cast<float>();
  const int rows = begin_.back();
  float least = std::numeric_limits<float>::infinity();
  for (int first = 0; first < rows; first += largest_) {
    const float distance = internal::SquaredDistances(
        points_.data() + first, static_cast<std::size_t>(points_.rows()),
        static_cast<std::size_t>(feature_dim_), workspace.z.data(),
        static_cast<std::size_t>(std::min(largest_, rows - first)), workspace.distances.data());
    if (std::isnan(distance)) return std::numeric_limits<double>::quiet_NaN();
    least = std::min(least, distance);
  }
  return std::sqrt(static_cast<double>(least));
}

bool TransitionStore::SumControls(int t, std::span<const double> z,
                                  Workspace& workspace) const noexcept {
  const auto [first, last] = Near(t);
  const int rows = last - first;
  if (rows <= 0) return false;
  const auto n = static_cast<std::size_t>(feature_dim_);
  const auto width = static_cast<std::size_t>(transitions_.cols());
  workspace.first = first;
  workspace.rows = rows;
  workspace.z.head(feature_dim_) = core::AsVector(z).cast<float>();
  workspace.least = internal::SquaredDistances(
      points_.data() + first, static_cast<std::size_t>(points_.rows()), n, workspace.z.data(),
      static_cast<std::size_t>(rows), workspace.distances.data());
  if (std::isnan(workspace.least)) return false;
  // Selects evenly over demonstrations and time steps.
  const int stride = (rows + kSpread - 1) / kSpread;
  workspace.stride = stride;
  workspace.used = (rows + stride - 1) / stride;
  for (int i = 0; i < workspace.used; ++i) workspace.spread[i] = i * stride;
  const auto used = static_cast<std::size_t>(workspace.used);
  const double sum = internal::Weights(workspace.distances.data(), workspace.spread.data(), used,
                                       workspace.least, kBandwidth / static_cast<double>(n),
                                       guided::kWeightFloor, workspace.weights.data());
  workspace.factor = options_.prior_weight / sum;
  const float* row = transitions_.row(first).data();
  // These sums take most of the time of an estimate. They have all columns of r after z and 1.
  const std::size_t begin = (n + 1) / internal::kWidth * internal::kWidth;
  internal::WeightedSums(row + n + 1, static_cast<std::size_t>(workspace.states), row + begin,
                         width - begin, static_cast<std::size_t>(stride) * width,
                         workspace.weights.data(), workspace.factor, used, workspace.tile.data(),
                         workspace.sums.data() + begin, width);
  return true;
}

void TransitionStore::SumStates(Workspace& workspace) const noexcept {
  SumRows(workspace.spread, workspace.weights, workspace.used, workspace.factor, workspace);
}

void TransitionStore::SumNearStates(Workspace& workspace,
                                    const Eigen::VectorXf& context) const noexcept {
  const auto rows = static_cast<std::size_t>(workspace.rows);
  const double scale = kBandwidth / feature_dim_;
  if (contexts_.cols() > 0) {
    // Recomputes the distances, because an earlier call may have added another context to them.
    internal::SquaredDistances(points_.data() + workspace.first,
                               static_cast<std::size_t>(points_.rows()),
                               static_cast<std::size_t>(feature_dim_), workspace.z.data(), rows,
                               workspace.distances.data());
    auto distances = workspace.distances.head(workspace.rows);
    const auto unit = static_cast<float>(feature_dim_ / kBandwidth);
    for (Eigen::Index k = 0; k < contexts_.cols(); ++k) {
      distances.array() +=
          unit *
          (contexts_.col(k).segment(workspace.first, workspace.rows).array() - context[k]).square();
    }
    workspace.least = distances.minCoeff();
    internal::Weights(distances.data(), workspace.spread.data(),
                      static_cast<std::size_t>(workspace.used), workspace.least, scale, 0.0,
                      workspace.weights.data());
  }
  const int count = std::min(workspace.rows, kNearest);
  internal::Nearest(workspace.distances.data(), rows, static_cast<std::size_t>(count),
                    workspace.nearest.data());
  internal::Weights(workspace.distances.data(), workspace.nearest.data(),
                    static_cast<std::size_t>(count), workspace.least, scale, 0.0,
                    workspace.near_weights.data());
  if (contexts_.cols() == 0) {
    // Adds the floor to the transitions to which SumControls() adds it.
    const int stride = workspace.stride;
    for (int i = 0; i < count; ++i) {
      const int index = workspace.nearest[i];
      const bool spread = stride <= 2 ? (index & (stride - 1)) == 0 : index % stride == 0;
      workspace.near_weights[i] += spread ? guided::kWeightFloor : 0.0;
    }
  }
  SumRows(workspace.nearest, workspace.near_weights, count, 1.0, workspace);
}

double TransitionStore::Share(Eigen::Index k, double gain,
                              const Workspace& workspace) const noexcept {
  double explained = 0.0;
  double left = 0.0;
  for (int i = 0; i < workspace.used; i += guided::kAgreementStride) {
    const auto row = transitions_.row(workspace.first + workspace.spread[i]);
    const double effect = gain * row[feature_dim_ + 1 + k];
    const double error = row.dot(workspace.residual);
    explained += workspace.weights[i] * effect * effect;
    left += workspace.weights[i] * error * error;
  }
  return explained + left > 0.0 ? explained / (explained + left) : 1.0;
}

void TransitionStore::SumRows(const Eigen::VectorXi& indices, const Eigen::VectorXd& weights,
                              int count, double factor, Workspace& workspace) const noexcept {
  const auto width = static_cast<std::size_t>(transitions_.cols());
  // Subtracts z: sums about the origin would lose significant digits.
  internal::WeightedSumsAbout(
      workspace.z.data(), transitions_.row(workspace.first).data(), width, indices.data(),
      weights.data(), factor, static_cast<std::size_t>(count),
      static_cast<std::size_t>(workspace.sums.rows() - workspace.states), workspace.tile.data(),
      workspace.sums.data() + static_cast<std::size_t>(workspace.states) * width);
}

}  // namespace dfr::control
