#include "dfr/control/response/local_fit.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "dfr/control/constants.h"
#include "small_system.h"

namespace dfr::control {
namespace {

// Returns the sum of the last `count` entries of the diagonal of (L L')^-1 with the lower triangle
// L of `l`. Writes L^-1 to `inverse`.
template <typename Block>
double TailOfInverseTrace(const Block& l, Eigen::Index count, Eigen::MatrixXd& inverse) noexcept {
  const Eigen::Index rows = l.rows();
  double trace = 0.0;
  for (Eigen::Index j = rows - count; j < rows; ++j) {
    for (Eigen::Index i = j; i < rows; ++i) {
      double sum = i == j ? 1.0 : 0.0;
      for (Eigen::Index k = j; k < i; ++k) sum -= l(i, k) * inverse(k, j);
      inverse(i, j) = sum / l(i, i);
      trace += inverse(i, j) * inverse(i, j);
    }
  }
  return trace;
}

}  // namespace

LocalFit::LocalFit(std::shared_ptr<const TransitionStore> prior,
                   const DisturbanceModel& disturbance_model, int drift_rows, Eigen::Index rows)
    : prior_(std::move(prior)), disturbance_model_(disturbance_model) {
  const int n = prior_->feature_dim();
  const int m = prior_->control_dim();
  z_ = disturbance_ = drift_ = wanted_ = Eigen::VectorXd::Zero(n);
  jacobian_ = Eigen::MatrixXd::Zero(n, m);
  demonstrated_ = b_ = core::Matrix::Zero(rows, n);
  a_ = a_online_ = Eigen::MatrixXd::Identity(rows, rows);
  factor_ = a_;
  transitions_ = prior_->MakeWorkspace();
  context_ = Eigen::VectorXf::Zero(prior_->context_dim());
  inverse_ = Eigen::MatrixXd::Identity(rows - drift_rows, rows - drift_rows);
  scratch_ = Eigen::VectorXd::Zero(m);
  a_demo_ = Eigen::MatrixXd::Identity(n + 1, n + 1);
  unit_ = Eigen::VectorXd::Zero(n + 1);
  h_ = Eigen::MatrixXd::Identity(m, m);
  did_ = Eigen::MatrixXd::Zero(m, 1);
}

bool LocalFit::DemonstratedControl(Eigen::VectorXd& v) noexcept {
  const auto& sums = transitions_.sums;
  const Eigen::Index n = jacobian_.rows();
  if (!has_transitions_) return false;
  prior_->SumNearStates(transitions_, context_);
  const Eigen::Index states = transitions_.states;
  // The lower triangle is sufficient.
  for (Eigen::Index i = 0; i <= n; ++i) {
    a_demo_.row(i).head(i + 1) = sums.row(states + i).head(i + 1).cast<double>();
  }
  const double weight = a_demo_(n, n);
  if (!(weight > 0.0)) return false;
  a_demo_.diagonal().head(n).array() += guided::kDemonstratedRidge * weight;
  internal::Factor(a_demo_);
  // At z, [z' - z; 1] is the last unit vector, and L^-1 scales it.
  const Eigen::MatrixXd& lower = a_demo_;
  for (Eigen::Index i = n; i >= 0; --i) {
    double sum = i == n ? 1.0 / lower(n, n) : 0.0;
    for (Eigen::Index k = i + 1; k <= n; ++k) sum -= lower(k, i) * unit_[k];
    unit_[i] = sum / lower(i, i);
  }
  // Squared distance of z from the mean of the transitions, relative to their covariance. Its mean
  // over the transitions is n. The regression does not extrapolate farther.
  const double distance = weight * unit_[n] - 1.0;
  if (const auto most = static_cast<double>(n); distance > most) {
    const double share = std::sqrt(most / distance);
    unit_ *= share;
    unit_[n] += (1.0 - share) / weight;
  }
  Regress(n + 1, v);
  return true;
}

void LocalFit::Regress(Eigen::Index column, Eigen::VectorXd& out) const noexcept {
  const auto& sums = transitions_.sums;
  internal::ForSumsOfColumns(&sums(transitions_.states, column), out.size(), sums.cols(),
                             unit_.data(), unit_.size(), [&](Eigen::Index i, const auto& combined) {
                               internal::Part(out.data(), i, combined) = combined;
                             });
}

bool LocalFit::NominalControl(Eigen::VectorXd& v) noexcept {
  const Eigen::Index n = jacobian_.rows();
  const Eigen::Index m = jacobian_.cols();
  if (!DemonstratedControl(v)) return false;
  if (prior_->options().measured_changes) {
    Regress(n + 1 + m, wanted_);
  } else {
    wanted_.noalias() = demonstrated_.bottomRows(m).transpose().lazyProduct(v);
    if (demonstrated_.rows() > m + n) wanted_ += demonstrated_.row(n).transpose();
  }
  wanted_ -= drift_;
  if (disturbance_model_.active()) wanted_ -= Duration(v) * disturbance_;
  for (Eigen::Index j = 0; j < m; ++j) {
    for (Eigen::Index i = j; i < m; ++i) {
      h_(i, j) = jacobian_.col(i).cwiseProduct(jacobian_.col(j)).sum();
    }
  }
  const double nearness = guided::kNearness * h_.trace() / static_cast<double>(m);
  if (!(nearness > 0.0)) return true;
  h_.diagonal().array() += nearness;
  scratch_.noalias() = jacobian_.transpose().lazyProduct(wanted_);
  did_ = scratch_ + nearness * v;
  internal::Factor(h_);
  internal::SolveFactored(h_, did_);
  v = did_.col(0);
  return true;
}

double LocalFit::Agreement(Eigen::Index k) noexcept {
  const Eigen::Index n = jacobian_.rows();
  const Eigen::Index m = jacobian_.cols();
  // Uses the demonstrated response only: an effect measured in this episode may differ from it even
  // where all demonstrations agree.
  const auto response = demonstrated_.bottomRows(m);
  const double gain = response.row(k).norm();
  if (!has_transitions_ || !(gain > 0.0)) return 1.0;
  wanted_ = response.row(k).transpose() / gain;
  scratch_.noalias() = response.lazyProduct(wanted_);
  auto slopes = unit_.head(n);
  slopes.setZero();
  double drift = 0.0;
  if (demonstrated_.rows() > m + n) {
    slopes.noalias() = demonstrated_.topRows(n).lazyProduct(wanted_);
    drift = demonstrated_.row(n).dot(wanted_);
  }
  Eigen::VectorXf& residual = transitions_.residual;
  residual.head(n) = -slopes.cast<float>();
  residual[n] = static_cast<float>(slopes.dot(z_) - drift);
  residual.segment(n + 1, m) = -scratch_.cast<float>();
  residual.segment(n + 1 + m, n) = wanted_.cast<float>();
  const double share = prior_->Share(k, gain, transitions_);
  const double used = transitions_.sums(k, n + 1 + k);
  const double ridge = prior_->options().ridge;
  return (ridge + used * share) / (ridge + used);
}

double LocalFit::DemonstratedSize(Eigen::Index k) const noexcept {
  if (!has_transitions_) return std::numeric_limits<double>::infinity();
  const double squares = transitions_.sums(k, jacobian_.rows() + 1 + k);
  return std::sqrt(std::max(0.0, squares / prior_->options().prior_weight));
}

void LocalFit::AddEffect(const Eigen::Ref<const Eigen::VectorXd>& v, double duration,
                         Eigen::Ref<Eigen::VectorXd> z) const noexcept {
  internal::ForSumsOfColumns(
      jacobian_.data(), jacobian_.rows(), jacobian_.rows(), v.data(), v.size(),
      [&](Eigen::Index i, const auto& effect) { internal::Part(z.data(), i, effect) += effect; });
  z += drift_;
  if (disturbance_model_.active()) z += duration * disturbance_;
}

double LocalFit::LeastExcitedDirection(std::span<double> direction, double known) noexcept {
  const Eigen::Index rows = inverse_.rows();
  const Eigen::Index m = jacobian_.cols();
  const auto lower = factor_.bottomRightCorner(rows, rows);
  // Near `known`, rounding of the fast sum could change the result.
  constexpr double kRounding = 1e-9;
  const double fast = TailOfInverseTrace(lower, m, inverse_);
  if (fast <= (1.0 - kRounding) * known) return fast;
  inverse_.setIdentity();
  if (rows <= internal::kMostOnStack) {
    lower.triangularView<Eigen::Lower>().solveInPlace(inverse_);
    lower.triangularView<Eigen::Lower>().adjoint().solveInPlace(inverse_);
  } else {
    for (auto column : inverse_.colwise()) {
      lower.triangularView<Eigen::Lower>().solveInPlace(column);
      lower.triangularView<Eigen::Lower>().adjoint().solveInPlace(column);
    }
  }
  if (const double bound = inverse_.diagonal().tail(m).sum(); bound <= known) return bound;
  // Finds the eigenvector by power iteration.
  auto v = core::AsVector(direction);
  v.setConstant(1.0 / std::sqrt(static_cast<double>(m)));
  // The constant vector may be orthogonal to the result by symmetry.
  for (Eigen::Index i = 0; i < m; ++i) v[i] += 0.01 * static_cast<double>(i);
  double value = 0.0;
  for (int i = 0; i < guided::kPowerIterations; ++i) {
    scratch_.noalias() = inverse_.bottomRightCorner(m, m).lazyProduct(v);
    value = scratch_.norm();
    v = scratch_ / value;
  }
  // The duration s is always positive, so [v; s] and [-v; s] differ in uncertainty.
  if (disturbance_model_.active() && inverse_.row(0).tail(m).dot(v) < 0.0) v = -v;
  return value;
}

}  // namespace dfr::control
