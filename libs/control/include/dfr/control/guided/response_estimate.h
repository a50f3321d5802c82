#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <memory>
#include <span>

#include "dfr/control/guided/transition_store.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// Duration of a control v, s = base + per_control |v|, during which a disturbance moves the
/// features: they change by J v + s d. The unit is arbitrary. Both 0: there is no disturbance.
struct DisturbanceModel {
  double base = 0.0;         ///< Constant part, >= 0.
  double per_control = 0.0;  ///< Additional duration of an ordinary control, >= 0.
};

/// Estimates how features change, dz = J v + m(z), without a model. J is the response to controls.
/// m(z) = m + M (z' - z) is the drift, which continues without a control (mass, gravity). The
/// estimate starts from nearby demonstrations and adds a correction for this episode. With w = [v;
/// 1; z' - z],
///   A_d = diag(ridges) + A_demo,  D = A_d^-1 B_demo,                     demonstrations near z
///   A = A_d + A_on,  [J m M] = (D + A^-1 E_on)'
///   after every applied control  A_on = f A_on + w w',  E_on = f E_on + w (dz - D' w)'
/// (recursive least squares with forgetting f; A_on and E_on move with z). E_on accumulates the
/// difference between the effect of a control and that of demonstrations at its state and time.
/// Demonstrations contain the beginning and end of a contact; sums of dz instead would predict the
/// response before it. The ridges of the drift exceed that of J, so a change that both explain is
/// attributed to controls.
///
/// With a disturbance model, w has one more entry, the duration s of the control. It separates the
/// disturbance d from the response to controls. For demonstrations s = 0. Never allocates after
/// construction.
class ResponseEstimate {
 public:
  /// @param drift  false: m = 0 and M = 0.
  /// @throws std::invalid_argument if a duration is negative or not finite.
  explicit ResponseEstimate(std::shared_ptr<const TransitionStore> prior,
                            const DisturbanceModel& disturbance_model = {}, bool drift = true);

  /// Removes the effect of all applied controls.
  void Reset() noexcept;
  /// Adds a measurement of `weight` >= 0: control `v` of duration s = `time` changed the features
  /// `z` by `dz`. Uses D of the last Compute() since Reset(), and D = 0 before the first. If there
  /// are demonstrations, begin an episode with Compute().
  void Update(std::span<const double> z, std::span<const double> v, std::span<const double> dz,
              double time, double weight) noexcept;
  /// Same as above with weight 1 and the duration Time(v).
  void Update(std::span<const double> z, std::span<const double> v,
              std::span<const double> dz) noexcept {
    Update(z, v, dz, Time(core::AsVector(v)), 1.0);
  }
  /// Computes J for time step `t` at `z`.
  void Compute(int t, std::span<const double> z) noexcept;

  /// Returns J, n x m, of the last Compute().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return jacobian_; }
  /// Returns d (n entries) of the last Compute(); 0 without a disturbance model.
  [[nodiscard]] const Eigen::VectorXd& disturbance() const noexcept { return disturbance_; }
  /// Returns m (n entries) of the last Compute(), the change of features without a control.
  [[nodiscard]] const Eigen::VectorXd& drift() const noexcept { return drift_; }
  /// Returns true if Compute() was called since the last Update().
  [[nodiscard]] bool fresh() const noexcept { return fresh_; }
  /// Returns the duration s of control `v` (m entries).
  [[nodiscard]] double Time(const Eigen::Ref<const Eigen::VectorXd>& v) const noexcept {
    return disturbance_model_.base + disturbance_model_.per_control * v.norm();
  }
  /// Computes the control with the effect of nearby demonstrations. Locally weighted linear
  /// regression over the nearest transitions gives the demonstrated control v_d at `z` and its
  /// change dz_d. The result minimizes |J v + m + s d - dz_d|^2 + 0.03 trace(J' J) / m |v - v_d|^2.
  /// It thereby compensates for rotated or scaled controls and for disturbances, as far as they are
  /// estimated. Uses the time step, z and results of the last Compute(). O(n^3).
  /// @returns false, and leaves `v` (m entries) unchanged, if there is no demonstrated control.
  [[nodiscard]] bool NominalControl(Eigen::VectorXd& v) noexcept;
  /// Returns true if NominalControl() predicts demonstrated actions poorly: it explains neither
  /// their variance nor their mean. In the gallery's tasks `explained` is at least .29, and
  /// smallest if paces differ between demonstrators. If the state lacks something that the
  /// demonstrator uses (a box, a velocity, a pole), it is at most .17, with an error of at least
  /// .46. For a constant action with noise it is 0, with an error of .2.
  /// @param explained  explained fraction of the variance of left-out actions.
  /// @param error  squared error, as a fraction of the squared actions.
  [[nodiscard]] static bool Guesses(double explained, double error) noexcept {
    constexpr double kLeastExplained = 0.2;
    constexpr double kMostError = 0.5;
    return explained < kLeastExplained && error > kMostError;
  }
  /// Adds J v + m + s d of the last Compute() to z, where s is Time(v), or `time`.
  void AddEffect(const Eigen::Ref<const Eigen::VectorXd>& v, double time,
                 Eigen::Ref<Eigen::VectorXd> z) const noexcept;
  void AddEffect(const Eigen::Ref<const Eigen::VectorXd>& v,
                 // A view. NOLINTNEXTLINE(performance-unnecessary-value-param)
                 Eigen::Ref<Eigen::VectorXd> z) const noexcept {
    AddEffect(v, Time(v), z);
  }

  /// Returns the largest eigenvalue of the block of A^-1 that belongs to v, and writes its
  /// eigenvector, the least excited control direction, to `direction` (m entries). With a
  /// disturbance model, its sign is the more informative one: repeating the same control would not
  /// separate its response from the disturbance.
  double LeastExcitedDirection(std::span<double> direction) noexcept;
  /// Returns the sum of the eigenvalues of this block, a faster upper bound on the largest.
  [[nodiscard]] double UncertaintyBound() noexcept;

 private:
  void MoveTo(std::span<const double> z) noexcept;
  /// Adds A_demo to a_ and B_demo to demonstrated_.
  void AddDemonstrations() noexcept;
  /// Sets b = A^-1 b with the factor of `cholesky_`; rows before `first` become undefined.
  void Solve(core::Matrix& b, Eigen::Index first) const noexcept;

  std::shared_ptr<const TransitionStore> prior_;
  DisturbanceModel disturbance_model_;
  bool disturbed_;
  // Rows of A and B: [z' - z (n); 1; s; v (m)], the first n + 1 only with a drift, s only
  // with a disturbance.
  int drift_rows_;
  Eigen::MatrixXd a_online_;
  core::Matrix b_online_;      ///< E_on
  Eigen::VectorXd center_;     ///< z at which A_on and E_on are centred.
  core::Matrix demonstrated_;  ///< D of the last Compute().
  Eigen::MatrixXd a_;
  core::Matrix b_;
  Eigen::LLT<Eigen::MatrixXd> cholesky_;
  Eigen::MatrixXd inverse_;  ///< Rows of s and v of A^-1.
  Eigen::MatrixXd jacobian_;
  Eigen::VectorXd disturbance_;
  Eigen::VectorXd drift_;
  Eigen::VectorXd regressor_;
  Eigen::VectorXd direction_;
  Eigen::VectorXd scratch_;
  TransitionStore::Workspace workspace_;
  bool has_sums_ = false;  ///< workspace_ has the sums of the last Compute().
  bool fresh_ = false;

  // For NominalControl().
  Eigen::MatrixXd a_demo_;
  Eigen::VectorXd unit_;  ///< n + 1
  Eigen::LLT<Eigen::MatrixXd> cholesky_demo_;
  Eigen::MatrixXd h_;
  Eigen::LLT<Eigen::MatrixXd> cholesky_controls_;
  Eigen::MatrixXd did_;     ///< m x 1
  Eigen::VectorXd wanted_;  ///< n
};

}  // namespace dfr::control
