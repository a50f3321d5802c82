#pragma once

#include <Eigen/Core>
#include <memory>
#include <span>

#include "dfr/control/response/transition_store.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// Duration of a control v, s = base + per_control |v|, during which a disturbance moves the
/// features: they change by J v + s d. The unit is arbitrary. If base and per_control are 0, there
/// is no disturbance.
struct DisturbanceModel {
  double base = 0.0;         ///< Constant part, >= 0.
  double per_control = 0.0;  ///< Additional duration of an ordinary control, >= 0.

  [[nodiscard]] bool active() const noexcept { return base > 0.0 || per_control > 0.0; }
  /// Returns the duration s of control `v`.
  [[nodiscard]] double Duration(const Eigen::Ref<const Eigen::VectorXd>& v) const noexcept {
    return base + per_control * v.norm();
  }
};

/// Local model of the change of features near one state, dz = J v + m + s d: the result of
/// ResponseEstimate::FitAt(). The fit stays valid when the estimate changes.
/// ResponseEstimate::MakeFit() allocates its memory; no member allocates, locks or throws.
/// Non-const functions use scratch memory and do not change the fit. One object belongs to one
/// thread.
class LocalFit {
 public:
  /// Returns the features z of the state. Before FitAt(), they and all other results are 0.
  [[nodiscard]] std::span<const double> z() const noexcept { return core::AsSpan(z_); }
  /// Returns J, n x m.
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return jacobian_; }
  /// Returns m (n entries), the change of features without a control.
  [[nodiscard]] const Eigen::VectorXd& drift() const noexcept { return drift_; }
  /// Returns d (n entries); 0 without a disturbance model.
  [[nodiscard]] const Eigen::VectorXd& disturbance() const noexcept { return disturbance_; }
  /// Returns the duration s of control `v` (m entries).
  [[nodiscard]] double Duration(const Eigen::Ref<const Eigen::VectorXd>& v) const noexcept {
    return disturbance_model_.Duration(v);
  }
  /// Adds J v + m + s d to z. s is `duration`, or Duration(v) in the overload without it.
  void AddEffect(const Eigen::Ref<const Eigen::VectorXd>& v, double duration,
                 Eigen::Ref<Eigen::VectorXd> z) const noexcept;
  void AddEffect(const Eigen::Ref<const Eigen::VectorXd>& v,
                 // A view. NOLINTNEXTLINE(performance-unnecessary-value-param)
                 Eigen::Ref<Eigen::VectorXd> z) const noexcept {
    AddEffect(v, disturbance_model_.active() ? Duration(v) : 0.0, z);
  }

  /// Computes the demonstrated control v_d at z by locally weighted linear regression over the
  /// nearest transitions. O(n^3).
  /// @returns false, and leaves `v` (m entries) unchanged, if there is no demonstrated control.
  [[nodiscard]] bool DemonstratedControl(Eigen::VectorXd& v) noexcept;
  /// Computes the control that changes features as v_d did in demonstrations. It minimises |J v + m
  /// + s d - dz_d|^2 + 0.03 trace(J' J) / m |v - v_d|^2. It compensates for rotated or scaled
  /// controls and for disturbances, as far as they are estimated. The demonstrated change dz_d
  /// comes from the same regression as v_d. Without ResponseOptions::measured_changes it is the
  /// change that J and m of demonstrations predict for v_d, and the result differs from v_d only
  /// because of measurements of this episode. O(n^3).
  /// @returns false, and leaves `v` (m entries) unchanged, if there is no demonstrated control.
  [[nodiscard]] bool NominalControl(Eigen::VectorXd& v) noexcept;
  /// Sets the context (TransitionStore::context_dim() entries) on which NominalControl() depends in
  /// addition to z. FitAt() keeps the context.
  void SetContext(std::span<const double> context) noexcept {
    context_ = core::AsVector(context).cast<float>();
  }
  /// Returns true if NominalControl() predicts demonstrated actions poorly: it explains neither
  /// their variance nor their mean. In the gallery's tasks `explained` is at least .29. Its
  /// smallest values occur if demonstrators differ in pace. If the state lacks information that the
  /// demonstrator uses (a box, a velocity, a pole), `explained` is at most .17 and `error` at least
  /// .46. For a constant action with noise, `explained` is 0 and `error` is .2.
  /// @param explained  explained fraction of the variance of left-out actions.
  /// @param error  squared error, as a fraction of the squared actions.
  [[nodiscard]] static bool Guesses(double explained, double error) noexcept {
    constexpr double kLeastExplained = 0.2;
    constexpr double kMostError = 0.5;
    return explained < kLeastExplained && error > kMostError;
  }

  /// Returns the agreement of nearby demonstrations on the effect of entry `k` of a control, in [0,
  /// 1]: the share of the variance along v_k's row of D that the entry explains, once the other
  /// entries and the drift are subtracted. If a contact begins nearby, J is a mean of two
  /// responses, and the share is small. The result is 1 if demonstrations did not use the entry: J
  /// then comes from measurements. O(n) for each transition used.
  [[nodiscard]] double Agreement(Eigen::Index k) noexcept;

  /// Returns the root mean square of entry `k` of the demonstrated controls near z, in ordinary
  /// controls. Returns infinity if there are no transitions.
  [[nodiscard]] double DemonstratedSize(Eigen::Index k) const noexcept;

  /// Returns the largest eigenvalue of the block of A^-1 that belongs to v, and writes its
  /// eigenvector, the least excited control direction, to `direction` (m entries). With a
  /// disturbance model, the direction has the more informative sign: repeating the same control
  /// would not separate its response from the disturbance. If the sum of the eigenvalues, a faster
  /// upper bound, is at most `known`, returns the sum and writes nothing.
  double LeastExcitedDirection(std::span<double> direction, double known = 0.0) noexcept;

 private:
  friend class ResponseEstimate;
  LocalFit(std::shared_ptr<const TransitionStore> prior, const DisturbanceModel& disturbance_model,
           int drift_rows, Eigen::Index rows);
  /// Computes the regression of DemonstratedControl() for the columns of the sums from `column` on.
  void Regress(Eigen::Index column, Eigen::VectorXd& out) const noexcept;

  std::shared_ptr<const TransitionStore> prior_;
  DisturbanceModel disturbance_model_;
  Eigen::VectorXd z_;
  Eigen::MatrixXd jacobian_;
  Eigen::VectorXd disturbance_;
  Eigen::VectorXd drift_;
  core::Matrix demonstrated_;               ///< D
  Eigen::MatrixXd factor_;                  ///< Cholesky factor of A, in the lower triangle.
  TransitionStore::Workspace transitions_;  ///< The transitions near z.
  bool has_transitions_ = false;
  Eigen::VectorXf context_;

  // Scratch of FitAt().
  Eigen::MatrixXd a_;
  Eigen::MatrixXd a_online_;
  core::Matrix b_;
  Eigen::MatrixXd inverse_;  ///< Scratch of LeastExcitedDirection(): block of A^-1 for s and v.
  // Scratch of several functions.
  Eigen::MatrixXd a_demo_;
  Eigen::VectorXd unit_;  ///< n + 1
  Eigen::MatrixXd h_;
  Eigen::MatrixXd did_;      ///< m x 1
  Eigen::VectorXd wanted_;   ///< n
  Eigen::VectorXd scratch_;  ///< m
};

}  // namespace dfr::control
