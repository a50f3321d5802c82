#include "dfr/study/online_lwr.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"

namespace dfr::study {

using core::AsSpan;

OnlineLwrPolicy::OnlineLwrPolicy(core::FeatureTransform features, control::Response response,
                                 const control::GuidedOptions& options)
    : features_(std::move(features)),
      response_(std::move(response)),
      online_weight_(options.online_weight),
      estimate_(response_.prior(), options.disturbance_model,
                options.drift && response_.has_drift()),
      fit_(estimate_.MakeFit()) {
  DFR_THROW_UNLESS(features_.num_features() == response_.feature_dim(),
                   "lwr-online: there are " << features_.num_features()
                                            << " features, but the response has "
                                            << response_.feature_dim());
  z_ = seen_ = change_ = Eigen::VectorXd::Zero(response_.feature_dim());
  v_ = applied_ = Eigen::VectorXd::Zero(response_.control_dim());
}

void OnlineLwrPolicy::Reset() noexcept {
  estimate_.Reset();
  has_applied_ = false;
}

void OnlineLwrPolicy::See(std::span<const double> x) noexcept {
  features_.Apply(x, AsSpan(z_));
  if (has_applied_ && z_.allFinite() && applied_.allFinite()) {
    change_ = z_ - seen_;
    estimate_.Update(fit_, AsSpan(seen_), AsSpan(applied_), AsSpan(change_),
                     fit_.Duration(applied_), online_weight_);
  }
  seen_ = z_;
  has_applied_ = false;
}

void OnlineLwrPolicy::Control(int t, std::span<const double> x,
                              std::span<double> u) const noexcept {
  features_.Apply(x, AsSpan(z_));
  bool known = z_.allFinite();
  if (known) {
    estimate_.FitAt(t, AsSpan(z_), fit_);
    known = fit_.NominalControl(v_);
  }
  const double unit = response_.control_unit();
  for (std::size_t i = 0; i < u.size(); ++i) {
    u[i] = known ? std::clamp(v_[static_cast<Eigen::Index>(i)] * unit, -1.0, 1.0)
                 : std::numeric_limits<double>::quiet_NaN();
  }
}

void OnlineLwrPolicy::Applied(std::span<const double> u) noexcept {
  applied_ = core::AsVector(u) / response_.control_unit();
  has_applied_ = seen_.allFinite();
}

}  // namespace dfr::study
