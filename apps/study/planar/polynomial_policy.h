#pragma once

#include <Eigen/Core>
#include <span>

#include "dfr/core/matrix.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"

namespace dfr::study::planar {

/// The learner of the planar tasks: each control entry is a polynomial of the standardised state,
/// by ridge regression on demonstrated pairs, clipped to +-1. The fit is fast, and the degree sets
/// the quality of imitation.
class PolynomialPolicy final : public core::Policy {
 public:
  static constexpr int kMaxStateDim = 8;

  /// @param degree  1, 2 or 3.
  /// @throws std::invalid_argument for another degree, a state that is too large, or no control.
  PolynomialPolicy(std::span<const core::Trajectory> demonstrations, int degree);

  [[nodiscard]] int state_dim() const noexcept override { return static_cast<int>(mean_.size()); }
  [[nodiscard]] int control_dim() const noexcept override {
    return static_cast<int>(weights_.cols());
  }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override;

 private:
  static constexpr int kMaxTerms = 165;  // 8 entries, degree 3
  int Terms(std::span<const double> x, std::span<double> terms) const noexcept;

  int degree_;
  Eigen::VectorXd mean_;
  Eigen::VectorXd scale_;
  core::Matrix weights_;
};

}  // namespace dfr::study::planar
