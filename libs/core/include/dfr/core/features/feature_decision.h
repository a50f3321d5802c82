#pragma once

#include <span>

#include "dfr/core/decision_function.h"
#include "dfr/core/features/feature_transform.h"

namespace dfr::core {

/// Adapts a decision function of features z to whole states: g_t(z(x)), l_t(z(x)). Borrows `inner`,
/// which must outlive it. A non-finite entry that no feature reads has no effect. (Controllers and
/// guards refuse such states.) curvature_bound() omits the curvature of StateMap::Circle.
class FeatureDecision final : public LogDecisionFunction {
 public:
  /// @throws std::invalid_argument if the number of features differs from inner's state_dim() or
  ///   exceeds FeatureTransform::kMaxFeatures.
  FeatureDecision(FeatureTransform features, const LogDecisionFunction& inner);

  [[nodiscard]] int state_dim() const noexcept override { return features_.state_dim(); }
  [[nodiscard]] int num_steps() const noexcept override { return inner_->num_steps(); }
  [[nodiscard]] double Decision(int t, std::span<const double> x) const noexcept override;
  double Gradient(int t, std::span<const double> x,
                  std::span<double> gradient) const noexcept override;
  double LogDecision(int t, std::span<const double> x,
                     std::span<double> gradient) const noexcept override;
  [[nodiscard]] double FromLog(int t, double l) const noexcept override {
    return inner_->FromLog(t, l);
  }
  [[nodiscard]] double curvature_bound(int t) const noexcept override {
    return inner_->curvature_bound(t) * norm_ * norm_;
  }

 private:
  // Applies the chain rule at `x`: converts a gradient with respect to z to one with respect to x.
  void Pull(std::span<const double> x, std::span<const double> inner,
            std::span<double> gradient) const noexcept;

  FeatureTransform features_;
  const LogDecisionFunction* inner_;
  double norm_;  // Spectral norm of the transform.
};

}  // namespace dfr::core
