#pragma once

#include <Eigen/Core>
#include <array>
#include <span>

#include "dfr/control/guided/response_estimate.h"

namespace dfr::control {

/// Tells the state that the next control will meet from the states that are seen: these are noisy,
/// and controls that were given may not have acted yet. Both show in what a ResponseEstimate
/// predicted of each control and what then happened. Nothing after construction allocates; one
/// object belongs to one thread.
///
/// An effect may come a few controls late, or be seen late. The lag is the smallest one, up to
/// kMaxLag, whose predictions J v_{k - lag} were not far worse than those of the best.
///
/// Noise of variance r in what is seen and q in what happens give prediction errors the variance
/// 2 r + q and, from one to the next, the covariance -r. The weight of what is seen is the Kalman
/// gain for q / r, at least 0.2, and 1 where they are not correlated so.
class StateObserver {
 public:
  static constexpr int kMaxLag = 3;

  /// @param forgetting  Weight that an error keeps at the next, in [0, 1).
  /// @param active  Off: states are what is seen of them, and controls act at once.
  StateObserver(int num_features, int control_dim, double forgetting, bool active = true);

  void Reset() noexcept;
  /// Control `v` was given, and what is seen of the features changed by `dz`. Learns from what
  /// `estimate` predicted, if it was computed for this control. To be called before the estimate's
  /// own Update().
  void Update(const ResponseEstimate& estimate, std::span<const double> v,
              std::span<const double> dz) noexcept;
  /// The control whose effect the last change shows, given lag() before the last one.
  [[nodiscard]] std::span<const double> acting() const noexcept {
    return {applied_.col(lag_).data(), static_cast<std::size_t>(applied_.rows())};
  }
  /// How many controls after its own an effect is seen, in [0, kMaxLag].
  [[nodiscard]] int lag() const noexcept { return lag_; }
  /// `z`, the features of what is seen, becomes what the controls under way will make of them:
  /// between what is seen and what was expected, and then moved by each of these controls. Once
  /// after each Update(), and at first.
  void Observe(const ResponseEstimate& estimate, Eigen::Ref<Eigen::VectorXd> z) noexcept;

 private:
  [[nodiscard]] int FindLag(const ResponseEstimate& estimate, std::span<const double> dz,
                            double time) noexcept;
  [[nodiscard]] double Gain() const noexcept;

  double forgetting_;
  bool active_;
  Eigen::MatrixXd applied_;                   ///< m x (kMaxLag + 1), the newest first.
  std::array<double, kMaxLag + 1> errors_{};  ///< Squared, of each lag's predictions.
  int lag_ = 0;
  Eigen::VectorXd error_;     ///< The last prediction's, or 0.
  double power_ = 0.0;        ///< Squared errors, with forgetting,
  double correlation_ = 0.0;  ///< and their products from one to the next.
  double travel_ = 0.0;       ///< Squared changes.
  Eigen::VectorXd expected_;  ///< The last estimate, after Update() with what was expected of it.
  bool expects_ = false;
  Eigen::VectorXd scratch_;
};

}  // namespace dfr::control
