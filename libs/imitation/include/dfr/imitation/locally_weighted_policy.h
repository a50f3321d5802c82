#pragma once

#include <span>
#include <vector>

#include "dfr/core/features/feature_transform.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"

namespace dfr::imitation {

/// Options for LocallyWeightedPolicy.
struct LocallyWeightedOptions {
  int window = 5;         ///< Uses the pairs with u != 0 at time steps t - window ... t + window;
                          ///< if there are none, the nearest in time.
  double width = 1.0;     ///< Width of the weights exp(-|z - z_i|^2 / (2 width^2)), > 0.
  double ridge = 0.1;     ///< Regularises the local slope towards zero, > 0.
  int max_per_step = 48;  ///< See core::SelectControls().
};

/// Locally weighted linear regression on the demonstrations (Atkeson, Moore and Schaal, 1997): u =
/// a + B (z - z_0), fitted by weighted least squares around the current features z_0.
///
/// The time step only selects the window. Immutable; concurrent calls are safe. The equations are
/// stored on the stack. A policy therefore has at most kMaxFeatures features and kMaxControls
/// control entries.
class LocallyWeightedPolicy final : public core::Policy {
 public:
  static constexpr int kMaxFeatures = 24;
  static constexpr int kMaxControls = 16;

  /// Leaves out pairs with u = 0 (padding) and clips controls to +-1.
  /// @throws std::invalid_argument if shapes do not fit, no control differs from zero, or an option
  ///   is out of range.
  LocallyWeightedPolicy(core::FeatureTransform features,
                        std::span<const core::Trajectory> demonstrations,
                        const LocallyWeightedOptions& options = {});

  [[nodiscard]] int state_dim() const noexcept override { return features_.state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override {
    return static_cast<int>(controls_.cols());
  }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override;

 private:
  core::FeatureTransform features_;
  LocallyWeightedOptions options_;
  std::vector<int> begin_;  ///< Entry t: first row of time step t. Last entry: number of rows.
  core::Matrix points_;
  core::Matrix controls_;
};

/// Returns the width, from a fixed grid of 0.25 to 4, with the smallest mean squared error of
/// LocallyWeightedPolicy on the controls of left-out demonstrations. Leaves out each of five folds
/// of whole demonstrations once. With fewer than five demonstrations, leaves out each demonstration
/// once. The other options come from `options`.
/// @throws std::invalid_argument with fewer than two demonstrations, and as LocallyWeightedPolicy.
[[nodiscard]] double CrossValidatedWidth(const core::FeatureTransform& features,
                                         std::span<const core::Trajectory> demonstrations,
                                         const LocallyWeightedOptions& options = {});

}  // namespace dfr::imitation
