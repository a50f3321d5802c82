#include "dfr/control/jacobian_estimate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"
#include "transition_sums.h"

namespace dfr::control {
namespace {

// Squared errors below this share of the squared changes, a hundredth each, are rounding and the
// ridge: no reason to find a lag or noise.
constexpr double kNegligible = 1e-4;
// Transitions that one estimate may look at.
constexpr int kMaxTransitions = 1024;
int RoundUp(int value, std::size_t multiple) {
  const int m = static_cast<int>(multiple);
  return (value + m - 1) / m * m;
}

// Entries of features and of a control: each decision solves a problem of the size of the control.
constexpr int kMaxEntries = 256;

void Check(const JacobianOptions& options) {
  DFR_THROW_UNLESS(options.ridge > 0.0, "ridge must be positive, not " << options.ridge);
  DFR_THROW_UNLESS(options.motion_ridge > 0.0,
                   "motion_ridge must be positive, not " << options.motion_ridge);
  DFR_THROW_UNLESS(options.slope_ridge > 0.0,
                   "slope_ridge must be positive, not " << options.slope_ridge);
  DFR_THROW_UNLESS(options.prior_weight >= 0.0,
                   "prior_weight must not be negative: " << options.prior_weight);
  DFR_THROW_UNLESS(options.window >= 0, "window must not be negative: " << options.window);
  DFR_THROW_UNLESS(options.max_per_step > 0,
                   "max_per_step must be positive, not " << options.max_per_step);
  DFR_THROW_UNLESS(options.window < kMaxTransitions &&
                       options.max_per_step <= kMaxTransitions / (2 * options.window + 1),
                   "(2 window + 1) max_per_step must be at most "
                       << kMaxTransitions << "; window is " << options.window << ", max_per_step "
                       << options.max_per_step);
  DFR_THROW_UNLESS(options.forgetting >= 0.0 && options.forgetting < 1.0,
                   "forgetting must lie in [0, 1), not be " << options.forgetting);
}

}  // namespace

JacobianPrior::JacobianPrior(std::span<const core::Matrix> features,
                             std::span<const core::Matrix> controls, const JacobianOptions& options)
    : options_(options) {
  Check(options);
  DFR_THROW_UNLESS(!features.empty() && features.size() == controls.size(),
                   features.size()
                       << " demonstrations of features, " << controls.size() << " of controls");
  feature_dim_ = static_cast<int>(features[0].cols());
  control_dim_ = static_cast<int>(controls[0].cols());
  const int n = feature_dim_;
  const int m = control_dim_;
  DFR_THROW_UNLESS(n >= 1 && n <= kMaxEntries && m >= 1 && m <= kMaxEntries,
                   "features have " << n << " entries, controls " << m << "; from 1 to "
                                    << kMaxEntries << " are possible");
  Eigen::Index longest = 0;
  for (std::size_t d = 0; d < features.size(); ++d) {
    DFR_THROW_UNLESS(features[d].cols() == n && controls[d].cols() == m &&
                         features[d].rows() == controls[d].rows() + 1,
                     "demonstration " << d << ": features " << features[d].rows() << " x "
                                      << features[d].cols() << ", controls " << controls[d].rows()
                                      << " x " << controls[d].cols());
    longest = std::max(longest, controls[d].rows());
  }

  std::vector<std::pair<std::size_t, Eigen::Index>> chosen;
  std::vector<std::size_t> moving;
  for (Eigen::Index t = 0; t < longest; ++t) {
    begin_.push_back(static_cast<int>(chosen.size()));
    moving.clear();
    for (std::size_t d = 0; d < controls.size(); ++d) {
      if (t < controls[d].rows() && controls[d].row(t).squaredNorm() > 0.0) moving.push_back(d);
    }
    const std::size_t most =
        std::min<std::size_t>(moving.size(), static_cast<std::size_t>(options.max_per_step));
    // Others than at the time step before: the window sees as many demonstrations as it can.
    for (std::size_t i = 0; i < most; ++i) {
      const std::size_t first = i * moving.size() / most;
      chosen.emplace_back(moving[(first + static_cast<std::size_t>(t)) % moving.size()], t);
    }
  }
  begin_.push_back(static_cast<int>(chosen.size()));

  transitions_.setZero(static_cast<Eigen::Index>(chosen.size()), Width());
  for (Eigen::Index row = 0; row < transitions_.rows(); ++row) {
    const auto [d, t] = chosen[static_cast<std::size_t>(row)];
    transitions_.row(row).head(2 * n + 1 + m) << features[d].row(t).cast<float>(), 1.0F,
        controls[d].row(t).cast<float>(),
        (features[d].row(t + 1) - features[d].row(t)).cast<float>();
  }
  Finish();
}

int JacobianPrior::Width() const noexcept {
  // The controls of a row are read in steps of kWidth.
  const int controls = feature_dim_ + 1 + RoundUp(control_dim_, internal::kWidth);
  return RoundUp(std::max(2 * feature_dim_ + 1 + control_dim_, controls), internal::kWidth);
}

void JacobianPrior::Finish() {
  points_.setZero(transitions_.rows() + Eigen::Index{internal::kPadding}, feature_dim_);
  points_.topRows(transitions_.rows()) = transitions_.leftCols(feature_dim_);
  for (int t = 0; t + 1 < static_cast<int>(begin_.size()); ++t) {
    const auto [first, last] = Near(t);
    largest_ = std::max(largest_, last - first);
  }
}

void JacobianPrior::Save(core::ArchiveWriter& archive) const {
  archive.Number(options_.ridge);
  archive.Number(options_.prior_weight);
  archive.Integer(options_.window);
  archive.Integer(options_.max_per_step);
  archive.Number(options_.forgetting);
  archive.Number(options_.motion_ridge);
  archive.Number(options_.slope_ridge);
  archive.Integer(feature_dim_);
  archive.Integer(control_dim_);
  archive.Integer(has_controls_ ? 1 : 0);
  archive.Integers(begin_);
  archive.MatrixBlock(transitions_.leftCols(2 * feature_dim_ + 1 + control_dim_).cast<double>());
}

JacobianPrior JacobianPrior::Load(core::ArchiveReader& archive) {
  JacobianPrior prior;
  try {
    JacobianOptions& options = prior.options_;
    options.ridge = archive.Number();
    options.prior_weight = archive.Number();
    options.window = archive.IntegerIn(0, kMaxTransitions);
    options.max_per_step = archive.IntegerIn(1, kMaxTransitions);
    options.forgetting = archive.Number();
    const bool old = archive.version() < kWithTransitions;
    if (!old) {
      options.motion_ridge = archive.Number();
      options.slope_ridge = archive.Number();
    }
    Check(options);
    prior.feature_dim_ = archive.IntegerIn(1, kMaxEntries);
    prior.control_dim_ = archive.IntegerIn(1, kMaxEntries);
    if (!old) prior.has_controls_ = archive.IntegerIn(0, 1) == 1;
    prior.begin_ = archive.Integers();
    const core::Matrix transitions = old ? prior.OldTransitions(archive) : archive.MatrixBlock();
    const std::vector<int>& begin = prior.begin_;
    DFR_THROW_UNLESS(
        begin.size() >= 2 && begin.front() == 0 && begin.back() == transitions.rows(),
        "the transitions of the Jacobian prior do not begin and end where they should");
    for (std::size_t t = 1; t < begin.size(); ++t) {
      DFR_THROW_UNLESS(begin[t] >= begin[t - 1] && begin[t] - begin[t - 1] <= options.max_per_step,
                       "time step " << t - 1 << " of the Jacobian prior has "
                                    << begin[t] - begin[t - 1] << " transitions");
    }
    const Eigen::Index n = prior.feature_dim_;
    DFR_THROW_UNLESS(transitions.cols() == 2 * n + 1 + prior.control_dim_,
                     "the matrix of the Jacobian prior does not fit its numbers of features and "
                     "control entries");
    prior.transitions_.setZero(transitions.rows(), prior.Width());
    prior.transitions_.leftCols(transitions.cols()) = transitions.cast<float>();
    DFR_THROW_UNLESS(prior.transitions_.allFinite() && (transitions.col(n).array() == 1.0).all(),
                     "the Jacobian prior has an entry that cannot be");
    prior.Finish();
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
  return prior;
}

// Earlier versions kept z, v (not before version 3), and the products v v' and v dz'.
core::Matrix JacobianPrior::OldTransitions(core::ArchiveReader& archive) {
  const Eigen::Index n = feature_dim_;
  const Eigen::Index m = control_dim_;
  const core::Matrix points = archive.MatrixBlock();
  has_controls_ = archive.version() >= 3;
  core::Matrix controls;
  if (has_controls_) controls = archive.MatrixBlock();
  const core::Matrix products = archive.MatrixBlock();
  DFR_THROW_UNLESS(
      points.cols() == n && products.rows() == points.rows() &&
          products.cols() == m * (m + 1) / 2 + m * n &&
          (!has_controls_ || (controls.rows() == points.rows() && controls.cols() == m)),
      "the matrices of the Jacobian prior do not fit each other");
  core::Matrix transitions(points.rows(), 2 * n + 1 + m);
  for (Eigen::Index row = 0; row < points.rows(); ++row) {
    // Whatever the sign of v: that of dz follows, and J is the same.
    Eigen::Index largest = 0;
    const auto square = [&](Eigen::Index i) { return products(row, i * (i + 3) / 2); };
    for (Eigen::Index i = 1; i < m; ++i) {
      if (square(i) > square(largest)) largest = i;
    }
    DFR_THROW_UNLESS(square(largest) > 0.0,
                     "transition " << row << " of the Jacobian prior has no control");
    double by = std::sqrt(square(largest));
    if (has_controls_ && controls(row, largest) < 0.0) by = -by;
    transitions.row(row).head(n) = points.row(row);
    transitions(row, n) = 1.0;
    for (Eigen::Index i = 0; i < m; ++i) {
      const Eigen::Index high = std::max(i, largest);
      transitions(row, n + 1 + i) =
          products(row, high * (high + 1) / 2 + std::min(i, largest)) / by;
    }
    for (Eigen::Index k = 0; k < n; ++k) {
      transitions(row, n + 1 + m + k) = products(row, m * (m + 1) / 2 + k * m + largest) / by;
    }
  }
  return transitions;
}

std::pair<int, int> JacobianPrior::Near(int t) const noexcept {
  const int steps = static_cast<int>(begin_.size()) - 1;
  t = std::min(t, steps - 1);
  return {begin_[static_cast<std::size_t>(std::clamp(t - options_.window, 0, steps))],
          begin_[static_cast<std::size_t>(std::clamp(t + options_.window + 1, 0, steps))]};
}

JacobianPrior::Workspace JacobianPrior::MakeWorkspace() const {
  Workspace workspace;
  workspace.states = RoundUp(control_dim_, internal::kWidth);
  const int left = workspace.states + RoundUp(feature_dim_ + 1, internal::kWidth);
  workspace.distances.setZero(largest_ + Eigen::Index{internal::kPadding});
  workspace.weights.setZero(largest_ + Eigen::Index{internal::kPadding});
  workspace.spread.setZero(kSpread);
  workspace.nearest.setZero(kNearest + 1);
  workspace.z.setZero(Width());
  workspace.left.setZero(Eigen::Index{std::min(largest_, kSpread)} * left);
  workspace.right.setZero(Eigen::Index{std::min(largest_, kSpread)} * Width());
  workspace.sums.setZero(left, Width());
  return workspace;
}

bool JacobianPrior::SumControls(int t, std::span<const double> z,
                                Workspace& workspace) const noexcept {
  const auto [first, last] = Near(t);
  const int rows = last - first;
  if (rows <= 0) return false;
  const auto count = static_cast<std::size_t>(rows);
  const auto n = static_cast<std::size_t>(feature_dim_);
  const auto width = static_cast<std::size_t>(transitions_.cols());
  const auto left_width = static_cast<std::size_t>(workspace.sums.rows());
  workspace.first = first;
  workspace.rows = rows;
  workspace.z.head(feature_dim_) = core::AsVector(z).cast<float>();
  internal::SquaredDistances(points_.data() + first, static_cast<std::size_t>(points_.rows()), n,
                             workspace.z.data(), count, workspace.distances.data());
  const auto distances = workspace.distances.head(rows);
  if (!std::isfinite(distances.sum())) return false;
  internal::Weights(distances.data(), count, distances.minCoeff(),
                    kBandwidth / static_cast<double>(n), workspace.weights.data());
  // Evenly over demonstrations and time steps.
  const int stride = (rows + kSpread - 1) / kSpread;
  workspace.used = (rows + stride - 1) / stride;
  // Where all of them are far from z, none of them counts more than the others.
  constexpr double kFloor = 1e-6;
  double sum = 0.0;
  for (int i = 0; i < workspace.used; ++i) {
    workspace.spread[i] = i * stride;
    sum += workspace.weights[i * stride] += kFloor;
  }
  workspace.factor = options_.prior_weight / sum;
  const float* row = transitions_.row(first).data();
  const std::size_t row_stride = static_cast<std::size_t>(stride) * width;
  const auto used = static_cast<std::size_t>(workspace.used);
  internal::ScaleRows(row + n + 1, row_stride, workspace.spread.data(), used,
                      workspace.weights.data(), workspace.factor,
                      static_cast<std::size_t>(workspace.states), workspace.left.data(),
                      left_width);
  // Most of the work of an estimate. Of r all that may follow z and 1.
  const std::size_t begin = (n + 1) / internal::kWidth * internal::kWidth;
  internal::TransposedProduct(workspace.left.data(), left_width,
                              static_cast<std::size_t>(workspace.states), row + begin, row_stride,
                              width - begin, used, workspace.sums.data() + begin, width);
  return true;
}

void JacobianPrior::SumStates(Workspace& workspace) const noexcept {
  SumRows(workspace.spread, workspace.used, workspace.factor, workspace);
}

void JacobianPrior::SumNearStates(Workspace& workspace) const noexcept {
  const int count = std::min(workspace.rows, kNearest);
  internal::Nearest(workspace.distances.data(), static_cast<std::size_t>(workspace.rows),
                    static_cast<std::size_t>(count), workspace.nearest.data());
  SumRows(workspace.nearest, count, 1.0, workspace);
}

void JacobianPrior::SumRows(const Eigen::VectorXi& indices, int count, double factor,
                            Workspace& workspace) const noexcept {
  const auto rows = static_cast<std::size_t>(count);
  const auto width = static_cast<std::size_t>(transitions_.cols());
  const auto left_width = static_cast<std::size_t>(workspace.sums.rows());
  const auto begin = static_cast<std::size_t>(workspace.states);
  // As they differ from z: sums about the origin would lose the digits that matter.
  internal::Differences(transitions_.row(workspace.first).data(), width, indices.data(), rows,
                        workspace.z.data(), workspace.right.data());
  internal::ScaleRows(workspace.right.data(), width, indices.data(), rows, workspace.weights.data(),
                      factor, left_width - begin, workspace.left.data() + begin, left_width);
  internal::TransposedProduct(workspace.left.data() + begin, left_width, left_width - begin,
                              workspace.right.data(), width, width, rows,
                              workspace.sums.data() + begin * width, width);
}

JacobianEstimate::JacobianEstimate(std::shared_ptr<const JacobianPrior> prior,
                                   const DriftTime& drift_time, const EstimateScope& scope)
    : prior_(std::move(prior)),
      drift_time_(drift_time),
      scope_{scope.own_motion && prior_->has_controls(), scope.lag, scope.smoothing},
      drifts_(drift_time.rest > 0.0 || drift_time.travel > 0.0) {
  DFR_THROW_UNLESS(drift_time.rest >= 0.0 && std::isfinite(drift_time.rest) &&
                       drift_time.travel >= 0.0 && std::isfinite(drift_time.travel),
                   "drift times must not be negative, and finite: rest "
                       << drift_time.rest << ", travel " << drift_time.travel);
  const int n = prior_->feature_dim();
  const int m = prior_->control_dim();
  motion_rows_ = scope_.own_motion ? n + 1 : 0;
  const int rows = motion_rows_ + (drifts_ ? 1 : 0) + m;
  a_online_ = Eigen::MatrixXd::Zero(rows, rows);
  b_online_ = core::Matrix::Zero(rows, n);
  center_ = Eigen::VectorXd::Zero(n);
  a_ = Eigen::MatrixXd::Identity(rows, rows);
  b_ = core::Matrix::Zero(rows, n);
  cholesky_ = Eigen::LLT<Eigen::MatrixXd>(a_);
  inverse_ = Eigen::MatrixXd::Identity(rows - motion_rows_, rows - motion_rows_);
  jacobian_ = Eigen::MatrixXd::Zero(n, m);
  drift_ = Eigen::VectorXd::Zero(n);
  own_motion_ = Eigen::VectorXd::Zero(n);
  regressor_ = Eigen::VectorXd::Zero(rows);
  direction_ = Eigen::VectorXd::Zero(m);
  scratch_ = Eigen::VectorXd::Zero(m);
  workspace_ = prior_->MakeWorkspace();
  applied_ = Eigen::MatrixXd::Zero(m, kMaxLag + 1);
  residual_ = Eigen::VectorXd::Zero(n);
  expected_ = Eigen::VectorXd::Zero(n);
  a_demo_ = Eigen::MatrixXd::Identity(n + 1, n + 1);
  unit_ = Eigen::VectorXd::Zero(n + 1);
  cholesky_demo_ = Eigen::LLT<Eigen::MatrixXd>(a_demo_);
  h_ = Eigen::MatrixXd::Identity(m, m);
  cholesky_controls_ = Eigen::LLT<Eigen::MatrixXd>(h_);
  did_ = Eigen::MatrixXd::Zero(m, 1);
  wanted_ = Eigen::VectorXd::Zero(n);
}

void JacobianEstimate::Reset() noexcept {
  a_online_.setZero();
  b_online_.setZero();
  applied_.setZero();
  errors_.fill(0.0);
  residual_.setZero();
  power_ = 0.0;
  travel_ = 0.0;
  correlation_ = 0.0;
  expects_ = false;
  fresh_ = false;
  lag_ = 0;
}

void JacobianEstimate::Update(std::span<const double> z, std::span<const double> v,
                              std::span<const double> dz, double weight) noexcept {
  for (Eigen::Index i = kMaxLag; i > 0; --i) applied_.col(i) = applied_.col(i - 1);
  applied_.col(0) = core::AsVector(v);
  const double time = Time(applied_.col(0).norm());
  if (fresh_) {
    travel_ = prior_->options().forgetting * travel_ + core::AsVector(dz).squaredNorm();
    if (scope_.lag) lag_ = FindLag(dz, time);
    wanted_ = own_motion_;
    wanted_.noalias() += jacobian_.lazyProduct(applied_.col(lag_));
    if (drifts_) wanted_ += time * drift_;
    expected_ += wanted_;
    wanted_ = core::AsVector(dz) - wanted_;
    power_ = prior_->options().forgetting * power_ + wanted_.squaredNorm();
    correlation_ = prior_->options().forgetting * correlation_ + wanted_.dot(residual_);
    residual_ = wanted_;
  } else {
    residual_.setZero();
  }
  expects_ = fresh_ && expected_.allFinite();
  fresh_ = false;
  if (motion_rows_ > 0) {
    regressor_.head(motion_rows_ - 1) = core::AsVector(z) - center_;
    regressor_[motion_rows_ - 1] = 1.0;
  }
  if (drifts_) regressor_[motion_rows_] = time;
  regressor_.tail(applied_.rows()) = applied_.col(lag_);
  const double keep = prior_->options().forgetting;
  a_online_ *= keep;
  b_online_ *= keep;
  a_online_.noalias() += weight * regressor_.lazyProduct(regressor_.transpose());
  b_online_.noalias() += weight * regressor_.lazyProduct(core::AsVector(dz).transpose());
}

void JacobianEstimate::Smooth(Eigen::Ref<Eigen::VectorXd> z) noexcept {
  // Below this the estimate would hardly look any more.
  constexpr double kLeastGain = 0.2;
  if (scope_.smoothing && expects_ && correlation_ < 0.0 && power_ > kNegligible * travel_) {
    const double ratio = std::max(0.0, -power_ / correlation_ - 2.0);
    const double gain = std::max(kLeastGain, (std::sqrt(ratio * (ratio + 4.0)) - ratio) / 2.0);
    z = gain * z + (1.0 - gain) * expected_;
  }
  expected_ = z;
}

int JacobianEstimate::FindLag(std::span<const double> dz, double time) noexcept {
  // Predictions of a lag have to be so much better, in squared error, than those of a smaller one.
  constexpr double kEvidence = 2.0;
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i <= kMaxLag; ++i) {
    wanted_ = core::AsVector(dz) - own_motion_;
    if (drifts_) wanted_ -= time * drift_;
    wanted_.noalias() -= jacobian_.lazyProduct(applied_.col(i));
    double& error = errors_[static_cast<std::size_t>(i)];
    error = prior_->options().forgetting * error + wanted_.squaredNorm();
    least = std::min(least, error);
  }
  // What is predicted well enough is not late, whatever would be predicted better.
  const double enough = std::max(kEvidence * least, kNegligible * travel_);
  int lag = 0;
  while (errors_[static_cast<std::size_t>(lag)] > enough) ++lag;
  return lag;
}

// With y = z' - z, sums of [y; 1] about another z are those of [y + shift; 1].
void JacobianEstimate::MoveTo(std::span<const double> z) noexcept {
  if (motion_rows_ == 0) return;
  const Eigen::Index n = motion_rows_ - 1;
  wanted_ = center_ - core::AsVector(z);
  center_ = core::AsVector(z);
  a_online_.topRows(n) += wanted_.lazyProduct(a_online_.row(n));
  a_online_.leftCols(n) += a_online_.col(n).lazyProduct(wanted_.transpose());
  b_online_.topRows(n) += wanted_.lazyProduct(b_online_.row(n));
}

void JacobianEstimate::AddDemonstrations() noexcept {
  const auto& sums = workspace_.sums;
  const Eigen::Index n = jacobian_.rows();
  const Eigen::Index m = jacobian_.cols();
  const Eigen::Index moves = motion_rows_;
  const Eigen::Index states = workspace_.states;
  const Eigen::Index v = n + 1;  // In the sums; then the changes.
  a_.bottomRightCorner(m, m) += sums.block(0, v, m, m).cast<double>();
  b_.bottomRows(m) += sums.block(0, v + m, m, n).cast<double>();
  if (moves == 0) return;
  prior_->SumStates(workspace_);
  // The lower triangle is enough.
  a_.topLeftCorner(moves, moves) += sums.block(states, 0, moves, moves).cast<double>();
  a_.bottomLeftCorner(m, moves) += sums.block(states, v, moves, m).transpose().cast<double>();
  b_.topRows(moves) += sums.block(states, v + m, moves, n).cast<double>();
}

void JacobianEstimate::Compute(int t, std::span<const double> z) noexcept {
  const JacobianOptions& options = prior_->options();
  MoveTo(z);
  a_ = a_online_;
  b_ = b_online_;
  a_.diagonal().array() += options.ridge;
  if (motion_rows_ > 0) {
    a_.diagonal().head(motion_rows_ - 1).array() += options.slope_ridge - options.ridge;
    a_(motion_rows_ - 1, motion_rows_ - 1) += options.motion_ridge - options.ridge;
  }
  has_sums_ = prior_->SumControls(t, z, workspace_);
  if (has_sums_) AddDemonstrations();
  cholesky_.compute(a_);
  const auto& lower = cholesky_.matrixLLT();
  // B becomes L^-1 B; of A^-1 B only the rows below the slopes matter.
  const Eigen::Index first = std::max(0, motion_rows_ - 1);
  for (Eigen::Index i = 0; i < b_.rows(); ++i) {
    for (Eigen::Index k = 0; k < i; ++k) b_.row(i) -= lower(i, k) * b_.row(k);
    b_.row(i) /= lower(i, i);
  }
  for (Eigen::Index i = b_.rows() - 1; i >= first; --i) {
    for (Eigen::Index k = i + 1; k < b_.rows(); ++k) b_.row(i) -= lower(k, i) * b_.row(k);
    b_.row(i) /= lower(i, i);
  }
  if (motion_rows_ > 0) own_motion_ = b_.row(first);
  if (drifts_) drift_ = b_.row(motion_rows_);
  jacobian_ = b_.bottomRows(jacobian_.cols()).transpose();
  fresh_ = true;
}

bool JacobianEstimate::Demonstrated(Eigen::VectorXd& v) noexcept {
  // For the slopes, per unit of weight: where states hardly differ in a direction, the control does
  // not depend on it.
  constexpr double kRidge = 0.1;
  constexpr double kNearness = 0.03;
  const auto& sums = workspace_.sums;
  const Eigen::Index n = jacobian_.rows();
  const Eigen::Index m = jacobian_.cols();
  if (!has_sums_ || !prior_->has_controls()) return false;
  prior_->SumNearStates(workspace_);
  const Eigen::Index states = workspace_.states;
  a_demo_ = sums.block(states, 0, n + 1, n + 1).cast<double>();
  const double weight = a_demo_(n, n);
  if (!(weight > 0.0)) return false;
  a_demo_.diagonal().head(n).array() += kRidge * weight;
  cholesky_demo_.compute(a_demo_);
  // At z itself, [z' - z; 1] is the last unit vector, and L^-1 of it a multiple.
  const auto& lower = cholesky_demo_.matrixLLT();
  for (Eigen::Index i = n; i >= 0; --i) {
    double sum = i == n ? 1.0 / lower(n, n) : 0.0;
    for (Eigen::Index k = i + 1; k <= n; ++k) sum -= lower(k, i) * unit_[k];
    unit_[i] = sum / lower(i, i);
  }
  v.noalias() = sums.block(states, n + 1, n + 1, m).transpose().cast<double>().lazyProduct(unit_);
  wanted_.noalias() =
      sums.block(states, n + 1 + m, n + 1, n).transpose().cast<double>().lazyProduct(unit_);
  wanted_ -= own_motion_;
  if (drifts_) wanted_ -= Time(v.norm()) * drift_;
  h_.noalias() = jacobian_.transpose().lazyProduct(jacobian_);
  const double nearness = kNearness * h_.trace() / static_cast<double>(m);
  if (!(nearness > 0.0)) return true;
  h_.diagonal().array() += nearness;
  scratch_.noalias() = jacobian_.transpose().lazyProduct(wanted_);
  did_ = scratch_ + nearness * v;
  cholesky_controls_.compute(h_);
  cholesky_controls_.solveInPlace(did_);
  v = did_.col(0);
  return true;
}

void JacobianEstimate::AddEffect(const Eigen::VectorXd& v,
                                 Eigen::Ref<Eigen::VectorXd> z) const noexcept {
  z.noalias() += jacobian_.lazyProduct(v);
  z += own_motion_;
  if (drifts_) z += Time(v.norm()) * drift_;
}

void JacobianEstimate::AddPending(Eigen::Ref<Eigen::VectorXd> z) const noexcept {
  for (int i = 0; i < lag_; ++i) {
    z.noalias() += jacobian_.lazyProduct(applied_.col(i));
    z += own_motion_;
    if (drifts_) z += Time(applied_.col(i).norm()) * drift_;
  }
}

double JacobianEstimate::Ignorance() noexcept {
  const Eigen::Index rows = inverse_.rows();
  inverse_.setIdentity();
  const auto lower =
      cholesky_.matrixLLT().bottomRightCorner(rows, rows).triangularView<Eigen::Lower>();
  lower.solveInPlace(inverse_);
  lower.adjoint().solveInPlace(inverse_);
  return inverse_.diagonal().tail(jacobian_.cols()).sum();
}

double JacobianEstimate::LeastKnown(std::span<double> direction) noexcept {
  static_cast<void>(Ignorance());
  // Power iteration: A^-1 is a few rows wide, and a direction that is nearly the least known is as
  // good as the least known.
  direction_.setConstant(1.0 / std::sqrt(static_cast<double>(direction_.size())));
  // Off the constant vector, which may by symmetry be orthogonal to the answer.
  for (Eigen::Index i = 0; i < direction_.size(); ++i) {
    direction_[i] += 0.01 * static_cast<double>(i);
  }
  const Eigen::Index m = jacobian_.cols();
  double value = 0.0;
  constexpr int kIterations = 30;
  for (int i = 0; i < kIterations; ++i) {
    scratch_.noalias() = inverse_.bottomRightCorner(m, m).lazyProduct(direction_);
    value = scratch_.norm();
    direction_ = scratch_ / value;
  }
  // Time always passes forwards: [v; s] and [-v; s] are not known equally well.
  if (drifts_ && inverse_.row(0).tail(m).dot(direction_) < 0.0) direction_ = -direction_;
  std::copy(direction_.begin(), direction_.end(), direction.begin());
  return value;
}

}  // namespace dfr::control
