#include "dfr/control/guided/response_estimate.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "dfr/control/guided/constants.h"
#include "dfr/core/contract.h"

namespace dfr::control {
namespace {

// Solves b = A^-1 b for columns [column, column + kColumns), with each row in registers. Rows
// before `first` get only the forward substitution.
template <int kColumns>
void SolveColumns(const Eigen::LLT<Eigen::MatrixXd>& cholesky, Eigen::Index column,
                  Eigen::Index first, core::Matrix& b) noexcept {
  const auto& lower = cholesky.matrixLLT();
  const Eigen::Index rows = b.rows();
  const auto row = [&](Eigen::Index i) {
    return Eigen::Map<Eigen::Array<double, 1, kColumns>>(b.data() + i * b.cols() + column);
  };
  for (Eigen::Index i = 0; i < rows; ++i) {
    Eigen::Array<double, 1, kColumns> sum = row(i);
    for (Eigen::Index k = 0; k < i; ++k) sum -= lower(i, k) * row(k);
    row(i) = sum / lower(i, i);
  }
  for (Eigen::Index i = rows - 1; i >= first; --i) {
    Eigen::Array<double, 1, kColumns> sum = row(i);
    for (Eigen::Index k = i + 1; k < rows; ++k) sum -= lower(k, i) * row(k);
    row(i) = sum / lower(i, i);
  }
}

}  // namespace

ResponseEstimate::ResponseEstimate(std::shared_ptr<const TransitionStore> prior,
                                   const DisturbanceModel& disturbance_model, bool drift)
    : prior_(std::move(prior)),
      disturbance_model_(disturbance_model),
      disturbed_(disturbance_model.base > 0.0 || disturbance_model.per_control > 0.0) {
  DFR_THROW_UNLESS(
      disturbance_model.base >= 0.0 && std::isfinite(disturbance_model.base) &&
          disturbance_model.per_control >= 0.0 && std::isfinite(disturbance_model.per_control),
      "disturbance_model: times must be finite and not negative: base "
          << disturbance_model.base << ", per_control " << disturbance_model.per_control);
  const int n = prior_->feature_dim();
  const int m = prior_->control_dim();
  drift_rows_ = drift ? n + 1 : 0;
  const int rows = drift_rows_ + (disturbed_ ? 1 : 0) + m;
  a_online_ = Eigen::MatrixXd::Zero(rows, rows);
  b_online_ = core::Matrix::Zero(rows, n);
  center_ = Eigen::VectorXd::Zero(n);
  demonstrated_ = core::Matrix::Zero(rows, n);
  a_ = Eigen::MatrixXd::Identity(rows, rows);
  b_ = core::Matrix::Zero(rows, n);
  cholesky_ = Eigen::LLT<Eigen::MatrixXd>(a_);
  inverse_ = Eigen::MatrixXd::Identity(rows - drift_rows_, rows - drift_rows_);
  jacobian_ = Eigen::MatrixXd::Zero(n, m);
  disturbance_ = Eigen::VectorXd::Zero(n);
  drift_ = Eigen::VectorXd::Zero(n);
  regressor_ = Eigen::VectorXd::Zero(rows);
  direction_ = Eigen::VectorXd::Zero(m);
  scratch_ = Eigen::VectorXd::Zero(m);
  workspace_ = prior_->MakeWorkspace();
  a_demo_ = Eigen::MatrixXd::Identity(n + 1, n + 1);
  unit_ = Eigen::VectorXd::Zero(n + 1);
  cholesky_demo_ = Eigen::LLT<Eigen::MatrixXd>(a_demo_);
  h_ = Eigen::MatrixXd::Identity(m, m);
  cholesky_controls_ = Eigen::LLT<Eigen::MatrixXd>(h_);
  did_ = Eigen::MatrixXd::Zero(m, 1);
  wanted_ = Eigen::VectorXd::Zero(n);
}

void ResponseEstimate::Reset() noexcept {
  a_online_.setZero();
  b_online_.setZero();
  center_.setZero();
  demonstrated_.setZero();
  fresh_ = false;
}

void ResponseEstimate::Update(std::span<const double> z, std::span<const double> v,
                              std::span<const double> dz, double time, double weight) noexcept {
  fresh_ = false;
  if (drift_rows_ > 0) {
    regressor_.head(drift_rows_ - 1) = core::AsVector(z) - center_;
    regressor_[drift_rows_ - 1] = 1.0;
  }
  if (disturbed_) regressor_[drift_rows_] = time;
  regressor_.tail(jacobian_.cols()) = core::AsVector(v);
  wanted_ = core::AsVector(dz);
  wanted_.noalias() -= demonstrated_.transpose().lazyProduct(regressor_);
  const double keep = prior_->options().forgetting;
  a_online_ *= keep;
  b_online_ *= keep;
  a_online_.noalias() += weight * regressor_.lazyProduct(regressor_.transpose());
  b_online_.noalias() += weight * regressor_.lazyProduct(wanted_.transpose());
}

// With y = z' - z, moving z changes sums of [y; 1] to those of [y + shift; 1].
void ResponseEstimate::MoveTo(std::span<const double> z) noexcept {
  if (drift_rows_ == 0) return;
  const Eigen::Index n = drift_rows_ - 1;
  wanted_ = center_ - core::AsVector(z);
  center_ = core::AsVector(z);
  a_online_.topRows(n) += wanted_.lazyProduct(a_online_.row(n));
  a_online_.leftCols(n) += a_online_.col(n).lazyProduct(wanted_.transpose());
  b_online_.topRows(n) += wanted_.lazyProduct(b_online_.row(n));
}

void ResponseEstimate::AddDemonstrations() noexcept {
  const auto& sums = workspace_.sums;
  const Eigen::Index n = jacobian_.rows();
  const Eigen::Index m = jacobian_.cols();
  const Eigen::Index moves = drift_rows_;
  const Eigen::Index states = workspace_.states;
  const Eigen::Index v = n + 1;  // First row of v in the sums.
  a_.bottomRightCorner(m, m) += sums.block(0, v, m, m).cast<double>();
  demonstrated_.bottomRows(m) += sums.block(0, v + m, m, n).cast<double>();
  if (moves == 0) return;
  prior_->SumStates(workspace_);
  // The lower triangle is enough.
  a_.topLeftCorner(moves, moves) += sums.block(states, 0, moves, moves).cast<double>();
  a_.bottomLeftCorner(m, moves) += sums.block(states, v, moves, m).transpose().cast<double>();
  demonstrated_.topRows(moves) += sums.block(states, v + m, moves, n).cast<double>();
}

void ResponseEstimate::Compute(int t, std::span<const double> z) noexcept {
  const ResponseOptions& options = prior_->options();
  MoveTo(z);
  a_.setZero();
  a_.diagonal().setConstant(options.ridge);
  if (drift_rows_ > 0) {
    a_.diagonal().head(drift_rows_ - 1).setConstant(options.slope_ridge);
    a_(drift_rows_ - 1, drift_rows_ - 1) = options.drift_ridge;
  }
  demonstrated_.setZero();
  has_sums_ = prior_->SumControls(t, z, workspace_);
  if (has_sums_) {
    AddDemonstrations();
    cholesky_.compute(a_);
    Solve(demonstrated_, 0);
  }
  a_ += a_online_;
  cholesky_.compute(a_);
  b_ = b_online_;
  // Slopes have no effect at z.
  const Eigen::Index first = std::max(0, drift_rows_ - 1);
  Solve(b_, first);
  b_ += demonstrated_;
  if (drift_rows_ > 0) drift_ = b_.row(first);
  if (disturbed_) disturbance_ = b_.row(drift_rows_);
  jacobian_ = b_.bottomRows(jacobian_.cols()).transpose();
  fresh_ = true;
}

void ResponseEstimate::Solve(core::Matrix& b, Eigen::Index first) const noexcept {
  Eigen::Index column = 0;
  for (; column + 8 <= b.cols(); column += 8) SolveColumns<8>(cholesky_, column, first, b);
  for (; column + 4 <= b.cols(); column += 4) SolveColumns<4>(cholesky_, column, first, b);
  for (; column < b.cols(); ++column) SolveColumns<1>(cholesky_, column, first, b);
}

bool ResponseEstimate::NominalControl(Eigen::VectorXd& v) noexcept {
  const auto& sums = workspace_.sums;
  const Eigen::Index n = jacobian_.rows();
  const Eigen::Index m = jacobian_.cols();
  if (!has_sums_) return false;
  prior_->SumNearStates(workspace_);
  const Eigen::Index states = workspace_.states;
  a_demo_ = sums.block(states, 0, n + 1, n + 1).cast<double>();
  const double weight = a_demo_(n, n);
  if (!(weight > 0.0)) return false;
  a_demo_.diagonal().head(n).array() += guided::kDemonstratedRidge * weight;
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
  wanted_ -= drift_;
  if (disturbed_) wanted_ -= Time(v) * disturbance_;
  h_.noalias() = jacobian_.transpose().lazyProduct(jacobian_);
  const double nearness = guided::kNearness * h_.trace() / static_cast<double>(m);
  if (!(nearness > 0.0)) return true;
  h_.diagonal().array() += nearness;
  scratch_.noalias() = jacobian_.transpose().lazyProduct(wanted_);
  did_ = scratch_ + nearness * v;
  cholesky_controls_.compute(h_);
  cholesky_controls_.solveInPlace(did_);
  v = did_.col(0);
  return true;
}

void ResponseEstimate::AddEffect(const Eigen::Ref<const Eigen::VectorXd>& v, double time,
                                 Eigen::Ref<Eigen::VectorXd> z) const noexcept {
  z.noalias() += jacobian_.lazyProduct(v);
  z += drift_;
  if (disturbed_) z += time * disturbance_;
}

double ResponseEstimate::UncertaintyBound() noexcept {
  const Eigen::Index rows = inverse_.rows();
  inverse_.setIdentity();
  const auto lower =
      cholesky_.matrixLLT().bottomRightCorner(rows, rows).triangularView<Eigen::Lower>();
  lower.solveInPlace(inverse_);
  lower.adjoint().solveInPlace(inverse_);
  return inverse_.diagonal().tail(jacobian_.cols()).sum();
}

double ResponseEstimate::LeastExcitedDirection(std::span<double> direction) noexcept {
  static_cast<void>(UncertaintyBound());
  // Power iteration.
  direction_.setConstant(1.0 / std::sqrt(static_cast<double>(direction_.size())));
  // Not the constant vector, which may be orthogonal to the result by symmetry.
  for (Eigen::Index i = 0; i < direction_.size(); ++i) {
    direction_[i] += 0.01 * static_cast<double>(i);
  }
  const Eigen::Index m = jacobian_.cols();
  double value = 0.0;
  for (int i = 0; i < guided::kPowerIterations; ++i) {
    scratch_.noalias() = inverse_.bottomRightCorner(m, m).lazyProduct(direction_);
    value = scratch_.norm();
    direction_ = scratch_ / value;
  }
  // The duration s is always positive, so [v; s] and [-v; s] differ in uncertainty.
  if (disturbed_ && inverse_.row(0).tail(m).dot(direction_) < 0.0) direction_ = -direction_;
  std::copy(direction_.begin(), direction_.end(), direction.begin());
  return value;
}

}  // namespace dfr::control
