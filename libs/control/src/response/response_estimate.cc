#include "dfr/control/response/response_estimate.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "dfr/control/constants.h"
#include "dfr/core/contract.h"
#include "small_system.h"

namespace dfr::control {
namespace {

// Sets b = (L L')^-1 b for columns [column, column + kColumns), with each row in registers. Rows
// before `first` get only the forward substitution.
template <int kColumns>
void SolveColumns(const Eigen::MatrixXd& lower, Eigen::Index column, Eigen::Index first,
                  core::Matrix& b) noexcept {
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

// Sets b = (L L')^-1 b; rows before `first` become undefined.
void Solve(const Eigen::MatrixXd& lower, core::Matrix& b, Eigen::Index first) noexcept {
  Eigen::Index column = 0;
  for (; column + 8 <= b.cols(); column += 8) SolveColumns<8>(lower, column, first, b);
  for (; column + 4 <= b.cols(); column += 4) SolveColumns<4>(lower, column, first, b);
  for (; column < b.cols(); ++column) SolveColumns<1>(lower, column, first, b);
}

// With y = z' - z, moving z by -shift changes sums of [y; 1] to sums of [y + shift; 1].
void Move(const Eigen::VectorXd& shift, Eigen::MatrixXd& a, core::Matrix& b) noexcept {
  const Eigen::Index n = shift.size();
  for (Eigen::Index j = a.cols() - 1; j >= 0; --j) {
    a.col(j).head(n) += a(n, j) * shift;
    if (j < n) a.col(j) += shift[j] * a.col(n);
  }
  for (Eigen::Index i = 0; i < n; ++i) b.row(i) += shift[i] * b.row(n);
}

}  // namespace

ResponseEstimate::ResponseEstimate(std::shared_ptr<const TransitionStore> prior,
                                   const DisturbanceModel& disturbance_model, bool drift)
    : prior_(std::move(prior)), disturbance_model_(disturbance_model) {
  DFR_THROW_UNLESS(
      disturbance_model.base >= 0.0 && std::isfinite(disturbance_model.base) &&
          disturbance_model.per_control >= 0.0 && std::isfinite(disturbance_model.per_control),
      "disturbance_model: times must be finite and not negative: base "
          << disturbance_model.base << ", per_control " << disturbance_model.per_control);
  const int n = prior_->feature_dim();
  drift_rows_ = drift ? n + 1 : 0;
  const int rows = drift_rows_ + (disturbance_model.active() ? 1 : 0) + prior_->control_dim();
  a_online_ = Eigen::MatrixXd::Zero(rows, rows);
  b_online_ = core::Matrix::Zero(rows, n);
  center_ = error_ = effect_ = Eigen::VectorXd::Zero(n);
  regressor_ = leverage_ = Eigen::VectorXd::Zero(rows);
}

LocalFit ResponseEstimate::MakeFit() const {
  return {prior_, disturbance_model_, drift_rows_, a_online_.rows()};
}

LocalFit ResponseEstimate::FitAt(int t, std::span<const double> z) const {
  LocalFit fit = MakeFit();
  FitAt(t, z, fit);
  return fit;
}

void ResponseEstimate::Reset() noexcept {
  a_online_.setZero();
  b_online_.setZero();
  center_.setZero();
  square_error_ = num_errors_ = 0.0;
  last_error_ = std::numeric_limits<double>::infinity();
}

void ResponseEstimate::Update(const LocalFit& fit, std::span<const double> z,
                              std::span<const double> v, std::span<const double> dz,
                              double duration, double weight) noexcept {
  if (drift_rows_ > 0) {
    if (center_ != fit.z_) {
      error_ = center_ - fit.z_;
      center_ = fit.z_;
      Move(error_, a_online_, b_online_);
    }
    regressor_.head(drift_rows_ - 1) = core::AsVector(z) - center_;
    regressor_[drift_rows_ - 1] = 1.0;
  }
  if (disturbance_model_.active()) regressor_[drift_rows_] = duration;
  regressor_.tail(prior_->control_dim()) = core::AsVector(v);
  error_ = core::AsVector(dz);
  internal::ForSumsOfColumns(fit.demonstrated_.data(), error_.size(), error_.size(),
                             regressor_.data(), regressor_.size(),
                             [&](Eigen::Index i, const auto& effect) {
                               internal::Part(error_.data(), i, effect) -= effect;
                             });
  const double keep = prior_->options().forgetting;
  effect_.setZero();
  fit.AddEffect(core::AsVector(v), duration, effect_);
  effect_ = core::AsVector(dz) - effect_;
  leverage_ = regressor_;
  fit.factor_.triangularView<Eigen::Lower>().solveInPlace(leverage_);
  const double error =
      std::min(error_.squaredNorm(), effect_.squaredNorm() / (1.0 + leverage_.squaredNorm()));
  square_error_ = keep * square_error_ + std::min(error, last_error_);
  last_error_ = error;
  num_errors_ = keep * num_errors_ + 1.0;
  a_online_ *= keep;
  b_online_ *= keep;
  a_online_.noalias() += weight * regressor_.lazyProduct(regressor_.transpose());
  b_online_.noalias() += weight * regressor_.lazyProduct(error_.transpose());
}

double ResponseEstimate::NoiseRidge() const noexcept {
  const double change = num_errors_ * prior_->mean_square_change();
  if (!(square_error_ > guided::kMostError * change) || change == 0.0) return 0.0;
  return guided::kNoiseRidge * (square_error_ / change - guided::kMostError);
}

void ResponseEstimate::AddDemonstrations(LocalFit& fit) const noexcept {
  const auto& sums = fit.transitions_.sums;
  const Eigen::Index n = prior_->feature_dim();
  const Eigen::Index m = prior_->control_dim();
  const Eigen::Index moves = drift_rows_;
  const Eigen::Index states = fit.transitions_.states;
  const Eigen::Index v = n + 1;  // First row of v in the sums.
  fit.a_.bottomRightCorner(m, m) += sums.block(0, v, m, m).cast<double>();
  fit.demonstrated_.bottomRows(m) += sums.block(0, v + m, m, n).cast<double>();
  if (moves == 0) return;
  prior_->SumStates(fit.transitions_);
  // The lower triangle is sufficient.
  fit.a_.topLeftCorner(moves, moves) += sums.block(states, 0, moves, moves).cast<double>();
  fit.a_.bottomLeftCorner(m, moves) += sums.block(states, v, moves, m).transpose().cast<double>();
  fit.demonstrated_.topRows(moves) += sums.block(states, v + m, moves, n).cast<double>();
}

void ResponseEstimate::FitAt(int t, std::span<const double> z, LocalFit& fit) const noexcept {
  const ResponseOptions& options = prior_->options();
  fit.z_ = core::AsVector(z);
  fit.a_.setZero();
  fit.a_.diagonal().setConstant(options.ridge);
  if (drift_rows_ > 0) fit.a_.diagonal().head(drift_rows_).setConstant(options.drift_ridge);
  fit.demonstrated_.setZero();
  fit.has_transitions_ = prior_->SumControls(t, z, fit.transitions_);
  if (fit.has_transitions_) {
    AddDemonstrations(fit);
    fit.factor_ = fit.a_;
    internal::Factor(fit.factor_);
    Solve(fit.factor_, fit.demonstrated_, 0);
  }
  fit.b_ = b_online_;
  if (drift_rows_ > 0) {
    // A few measurements of this episode cannot distinguish slopes from observation noise.
    fit.a_.diagonal().head(drift_rows_ - 1).array() += options.slope_ridge - options.drift_ridge;
    fit.a_online_ = a_online_;
    fit.wanted_ = center_ - fit.z_;
    Move(fit.wanted_, fit.a_online_, fit.b_);
    fit.a_ += fit.a_online_;
  } else {
    fit.a_ += a_online_;
  }
  fit.a_.diagonal().tail(prior_->control_dim()).array() += NoiseRidge();
  fit.factor_ = fit.a_;
  internal::Factor(fit.factor_);
  // Slopes have no effect at z.
  const Eigen::Index first = std::max(0, drift_rows_ - 1);
  Solve(fit.factor_, fit.b_, first);
  fit.b_ += fit.demonstrated_;
  if (drift_rows_ > 0) fit.drift_ = fit.b_.row(first);
  if (disturbance_model_.active()) fit.disturbance_ = fit.b_.row(drift_rows_);
  fit.jacobian_ = fit.b_.bottomRows(prior_->control_dim()).transpose();
}

}  // namespace dfr::control
