#include "dfr/control/guided/state_observer.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "dfr/control/constants.h"
#include "dfr/core/matrix.h"
#include "small_system.h"

namespace dfr::control {

StateObserver::StateObserver(int num_features, int control_dim, double forgetting, bool active)
    : forgetting_(forgetting),
      active_(active),
      applied_(Eigen::MatrixXd::Zero(control_dim, kMaxLag + 1)),
      error_(Eigen::VectorXd::Zero(num_features)),
      expected_(Eigen::VectorXd::Zero(num_features)),
      scratch_(Eigen::VectorXd::Zero(num_features)) {}

void StateObserver::Reset() noexcept {
  applied_.setZero();
  errors_.fill(0.0);
  lag_ = 0;
  error_.setZero();
  power_ = 0.0;
  correlation_ = 0.0;
  travel_ = 0.0;
  expects_ = false;
}

void StateObserver::Update(const LocalFit* fit, std::span<const double> v,
                           std::span<const double> dz) noexcept {
  for (Eigen::Index i = kMaxLag; i > 0; --i) applied_.col(i) = applied_.col(i - 1);
  applied_.col(0) = core::AsVector(v);
  if (!active_) return;
  if (fit != nullptr) {
    const double time = fit->Duration(applied_.col(0));
    travel_ = forgetting_ * travel_ + core::AsVector(dz).squaredNorm();
    lag_ = FindLag(*fit, dz, time);
    scratch_.setZero();
    fit->AddEffect(applied_.col(lag_), time, scratch_);
    expected_ += scratch_;
    scratch_ = core::AsVector(dz) - scratch_;
    power_ = forgetting_ * power_ + scratch_.squaredNorm();
    correlation_ = forgetting_ * correlation_ + scratch_.dot(error_);
    error_ = scratch_;
  } else {
    error_.setZero();
  }
  expects_ = fit != nullptr && expected_.allFinite();
}

void StateObserver::Observe(const LocalFit& fit, Eigen::Ref<Eigen::VectorXd> z) noexcept {
  if (!active_) return;
  if (const double gain = Gain(); gain < 1.0) z = gain * z + (1.0 - gain) * expected_;
  expected_ = z;
  for (Eigen::Index i = 0; i < lag_; ++i) fit.AddEffect(applied_.col(i), z);
}

double StateObserver::Gain() const noexcept {
  if (!expects_ || !(correlation_ < 0.0) || !(power_ > guided::kNegligible * travel_)) return 1.0;
  const double ratio = std::max(0.0, -power_ / correlation_ - 2.0);
  return std::max(guided::kLeastWeight, (std::sqrt(ratio * (ratio + 4.0)) - ratio) / 2.0);
}

int StateObserver::FindLag(const LocalFit& fit, std::span<const double> dz, double time) noexcept {
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i <= kMaxLag; ++i) {
    scratch_ = core::AsVector(dz) - fit.drift() - time * fit.disturbance();
    internal::ForSumsOfColumns(fit.jacobian().data(), scratch_.size(), scratch_.size(),
                               applied_.col(i).data(), applied_.rows(),
                               [&](Eigen::Index k, const auto& effect) {
                                 internal::Part(scratch_.data(), k, effect) -= effect;
                               });
    double& error = errors_[static_cast<std::size_t>(i)];
    error = forgetting_ * error + scratch_.squaredNorm();
    least = std::min(least, error);
  }
  // Selects the smallest lag whose predictions are accurate enough, even if a larger lag predicts
  // better.
  const double enough = std::max(guided::kEvidence * least, guided::kNegligible * travel_);
  int lag = 0;
  while (errors_[static_cast<std::size_t>(lag)] > enough) ++lag;
  return lag;
}

}  // namespace dfr::control
