#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/control/guided/guided_options.h"
#include "dfr/control/response/response.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/features/feature_transform.h"
#include "dfr/core/policy.h"

namespace dfr::study {

/// A controller that learns from its controls. If another control is applied instead, Applied()
/// reports it.
class LearnsOnline {
 public:
  virtual ~LearnsOnline() = default;
  virtual void Applied(std::span<const double> u) noexcept = 0;
};

/// "lwr-online": locally weighted regression with the kernel width of guided recovery, and an
/// estimate of the response J, which every applied control updates. Returns the control that has
/// the demonstrated effect with the current estimate (control::LocalFit::NominalControl()). It has
/// no support, filter, observer or probes. Call See() before each Control() and Applied() after it.
/// Belongs to one thread; after construction it never allocates.
class OnlineLwrPolicy final : public core::Policy {
 public:
  /// Uses disturbance_model, drift and online_weight of `options`.
  /// @throws std::invalid_argument if `features` and `response` have different numbers of features.
  OnlineLwrPolicy(core::FeatureTransform features, control::Response response,
                  const control::GuidedOptions& options = {});
  [[nodiscard]] int state_dim() const noexcept override { return features_.state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return response_.control_dim(); }

  /// Forgets the applied controls.
  void Reset() noexcept;
  /// Reports that state `x` follows the last applied control.
  void See(std::span<const double> x) noexcept;
  /// Writes a control, clipped to +-1; NaN in a non-finite state or without a demonstrated control.
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override;
  /// Reports that control `u` is applied in the state of the last See().
  void Applied(std::span<const double> u) noexcept;

 private:
  core::FeatureTransform features_;
  control::Response response_;
  double online_weight_;
  control::ResponseEstimate estimate_;
  mutable control::LocalFit fit_;  // Computed by the last Control().
  mutable Eigen::VectorXd z_;
  mutable Eigen::VectorXd v_;
  Eigen::VectorXd seen_;
  Eigen::VectorXd change_;
  Eigen::VectorXd applied_;
  bool has_applied_ = false;
};

}  // namespace dfr::study
