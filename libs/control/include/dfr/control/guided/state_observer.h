#pragma once

#include <Eigen/Core>
#include <array>
#include <span>

#include "dfr/control/response/local_fit.h"

namespace dfr::control {

/// Estimates, from noisy and delayed observations, the state once pending controls have taken
/// effect. Uses the prediction errors of LocalFit. Never allocates after construction; one object
/// belongs to one thread.
///
/// An effect may be observed a few controls late. The estimated lag is the smallest one, up to
/// kMaxLag, whose predictions J v_{k - lag} are not much worse than the best.
///
/// With observation noise of variance r and process noise of variance q, prediction errors have the
/// variance 2 r + q, and consecutive errors have the covariance -r. The weight of an observation is
/// the Kalman gain for q / r, at least 0.2, and 1 if the covariance is not negative.
class StateObserver {
 public:
  static constexpr int kMaxLag = 3;

  /// @param forgetting  factor on the weight of older errors, in [0, 1).
  /// @param active  false: observations are exact, and controls act at once.
  StateObserver(int num_features, int control_dim, double forgetting, bool active = true);

  void Reset() noexcept;
  /// Records that control `v` was applied and the observed features changed by `dz`.
  /// @param fit  the fit at the state in which `v` was chosen; nullptr if there is none.
  void Update(const LocalFit* fit, std::span<const double> v, std::span<const double> dz) noexcept;
  /// Returns the control whose effect the last change shows: lag() controls before the last one.
  [[nodiscard]] std::span<const double> acting() const noexcept {
    return {applied_.col(lag_).data(), static_cast<std::size_t>(applied_.rows())};
  }
  /// Returns the delay of effects, as a number of controls in [0, kMaxLag].
  [[nodiscard]] int lag() const noexcept { return lag_; }
  /// Replaces the observed features `z` by the features after all pending controls: a weighted mean
  /// of observed and expected features, plus the effects of these controls according to `fit`. Call
  /// it once at the start and after each Update().
  void Observe(const LocalFit& fit, Eigen::Ref<Eigen::VectorXd> z) noexcept;

 private:
  [[nodiscard]] int FindLag(const LocalFit& fit, std::span<const double> dz, double time) noexcept;
  [[nodiscard]] double Gain() const noexcept;

  double forgetting_;
  bool active_;
  Eigen::MatrixXd applied_;                   ///< m x (kMaxLag + 1), newest first.
  std::array<double, kMaxLag + 1> errors_{};  ///< Squared errors of each lag's predictions.
  int lag_ = 0;
  Eigen::VectorXd error_;     ///< Error of the last prediction, or 0.
  double power_ = 0.0;        ///< Sum of squared errors, with forgetting.
  double correlation_ = 0.0;  ///< Sum of products of consecutive errors, with forgetting.
  double travel_ = 0.0;       ///< Sum of squared changes, with forgetting.
  Eigen::VectorXd expected_;  ///< The last estimate. Update() adds the expected change.
  bool expects_ = false;
  Eigen::VectorXd scratch_;
};

}  // namespace dfr::control
