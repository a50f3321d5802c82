#pragma once

#include <Eigen/Core>
#include <limits>
#include <memory>
#include <span>

#include "dfr/control/response/local_fit.h"
#include "dfr/control/response/transition_store.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// Estimates how features change, dz = J v + m(z), without a model. J is the response to controls.
/// m(z) = m + M (z' - z) is the drift, which continues without a control (mass, gravity). The
/// estimate starts from nearby demonstrations and adds a correction for this episode. With w = [v;
/// 1; z' - z],
///   A_d = diag(ridges) + A_demo,  D = A_d^-1 B_demo,                     demonstrations near z
///   A = A_d + A_on,  [J m M] = (D + A^-1 E_on)'
///   after every applied control  A_on = f A_on + w w',  E_on = f E_on + w (dz - D' w)'
/// (recursive least squares with forgetting f; A_on and E_on move with z). E_on accumulates the
/// difference between the observed effect of a control and its effect in demonstrations at the same
/// state and time. Demonstrations show where a contact begins and ends. In a contact, sums of dz
/// alone would still predict the response before it. The drift has larger ridges than J, so a
/// change that both explain is attributed to controls.
///
/// If both predictions, D' w and the prediction of the fit, have large errors in consecutive steps,
/// the cause is sensor noise. Such errors raise the ridge of J in A. Otherwise J would follow the
/// noise for controls that demonstrations rarely contain. The squared error of the fit is divided
/// by 1 + w' A^-1 w, because its variance is that of the noise times this factor. Large errors of a
/// response that few measurements determine are thus not mistaken for noise.
///
/// With a disturbance model, w has one more entry, the duration s of the control. It separates the
/// disturbance d from the response to controls. For demonstrations s = 0.
///
/// FitAt() computes a LocalFit, from which all predictions come. Update() takes the fit of the
/// applied control. Neither allocates, locks or throws.
class ResponseEstimate {
 public:
  /// @param drift  false: m = 0 and M = 0.
  /// @throws std::invalid_argument if a duration is negative or not finite.
  explicit ResponseEstimate(std::shared_ptr<const TransitionStore> prior,
                            const DisturbanceModel& disturbance_model = {}, bool drift = true);

  /// Returns a zero fit for FitAt(), with all the memory that it needs. Allocates.
  [[nodiscard]] LocalFit MakeFit() const;
  /// Computes `fit`, which MakeFit() of this object must have created, for time step `t` at `z`.
  /// For a non-finite `z` the result is not finite.
  void FitAt(int t, std::span<const double> z, LocalFit& fit) const noexcept;
  /// Overload that returns a new fit. Allocates.
  [[nodiscard]] LocalFit FitAt(int t, std::span<const double> z) const;

  /// Removes the effect of all applied controls.
  void Reset() noexcept;
  /// Adds a measurement of `weight` >= 0: control `v` of duration s = `duration` changed the
  /// features `z` by `dz`. The measurement corrects the demonstrations' prediction: D' w of `fit`
  /// is subtracted from `dz`, and A_on and E_on are then centred on the z of `fit`.
  void Update(const LocalFit& fit, std::span<const double> z, std::span<const double> v,
              std::span<const double> dz, double duration, double weight) noexcept;
  /// Overload for the z of `fit`, with weight 1 and the duration of `v`.
  void Update(const LocalFit& fit, std::span<const double> v, std::span<const double> dz) noexcept {
    Update(fit, fit.z(), v, dz, fit.Duration(core::AsVector(v)), 1.0);
  }

 private:
  /// Returns the amount by which sensor noise raises the ridge of J.
  [[nodiscard]] double NoiseRidge() const noexcept;
  /// Adds A_demo to A and B_demo to D of `fit`.
  void AddDemonstrations(LocalFit& fit) const noexcept;

  std::shared_ptr<const TransitionStore> prior_;
  DisturbanceModel disturbance_model_;
  // Rows of A and B: [z' - z (n); 1; s; v (m)]. The first n + 1 exist only with a drift, s only
  // with a disturbance.
  int drift_rows_;
  Eigen::MatrixXd a_online_;
  core::Matrix b_online_;   ///< E_on
  Eigen::VectorXd center_;  ///< z at which A_on and E_on are centred.
  Eigen::VectorXd regressor_;
  Eigen::VectorXd leverage_;  ///< L^-1 w with A = L L'.
  Eigen::VectorXd error_;     ///< n
  Eigen::VectorXd effect_;    ///< n
  /// Smaller of the two squared errors in the last step. Infinite before the first error of an
  /// episode, so the first error counts.
  double last_error_ = std::numeric_limits<double>::infinity();
  double square_error_ = 0.0;  ///< Sum of the smaller of two consecutive errors, with forgetting.
  double num_errors_ = 0.0;    ///< Number of terms of square_error_, with forgetting.
};

}  // namespace dfr::control
