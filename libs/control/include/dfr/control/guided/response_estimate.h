#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <memory>
#include <span>

#include "dfr/control/guided/transition_store.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// The time that a control v takes, s = base + per_control |v|, while the world moves by itself:
/// features then change by J v + s d. Its unit does not matter. Both 0: nothing else moves the
/// world.
struct DisturbanceModel {
  double base = 0.0;         ///< Whatever the control, >= 0.
  double per_control = 0.0;  ///< An ordinary control's, >= 0.
};

/// Estimates how features change, dz = J v + m(z), without a model. J is the response to controls.
/// m(z) = m + M (z' - z) is the drift, which continues without a control (mass, gravity).
/// The estimate is what demonstrations did nearby, plus a correction for this episode. With
/// w = [v; 1; z' - z],
///   A_d = diag(ridges) + A_demo,  D = A_d^-1 B_demo,                     demonstrations near z
///   A = A_d + A_on,  [J m M] = (D + A^-1 E_on)'
///   after every applied control  A_on = f A_on + w w',  E_on = f E_on + w (dz - D' w)'
/// (recursive least squares with forgetting f; A_on and E_on move with z). E_on takes what a
/// control did beyond the demonstrations at its own state and time. A contact that begins or ends
/// is demonstrated; sums of dz instead would predict the response from before it. The ridges of the
/// drift are larger than that of J: a change that both explain is attributed to controls.
///
/// Where the world moves by itself, w has one more entry, the time s of the control. The
/// disturbance d is distinguished from the response to controls. Demonstrations were not disturbed,
/// their s is 0. Nothing after construction allocates.
class ResponseEstimate {
 public:
  /// @param drift  Off: nothing moves without a control, but for a disturbance.
  /// @throws std::invalid_argument if a time is negative or not finite.
  explicit ResponseEstimate(std::shared_ptr<const TransitionStore> prior,
                            const DisturbanceModel& disturbance_model = {}, bool drift = true);

  /// Forgets the applied controls.
  void Reset() noexcept;
  /// At features `z` the answer to control `v`, and what else went on for a time s = `time`, was
  /// `dz`; the measurement counts `weight` times, >= 0. D is that of the last Compute() since
  /// Reset(), 0 before the first: an episode begins with Compute() where there are demonstrations.
  void Update(std::span<const double> z, std::span<const double> v, std::span<const double> dz,
              double time, double weight) noexcept;
  /// Update() with a control that acted at once.
  void Update(std::span<const double> z, std::span<const double> v,
              std::span<const double> dz) noexcept {
    Update(z, v, dz, Time(core::AsVector(v)), 1.0);
  }
  /// Computes J for time step `t` at `z`.
  void Compute(int t, std::span<const double> z) noexcept;

  /// J, n x m, of the last Compute().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return jacobian_; }
  /// d, n, of the last Compute(); 0 where nothing else moves the world.
  [[nodiscard]] const Eigen::VectorXd& disturbance() const noexcept { return disturbance_; }
  /// m, n, of the last Compute(): what features do without a control.
  [[nodiscard]] const Eigen::VectorXd& drift() const noexcept { return drift_; }
  /// Whether Compute() was called since the last Update().
  [[nodiscard]] bool fresh() const noexcept { return fresh_; }
  /// s of control `v` (m entries).
  [[nodiscard]] double Time(const Eigen::Ref<const Eigen::VectorXd>& v) const noexcept {
    return disturbance_model_.base + disturbance_model_.per_control * v.norm();
  }
  /// The control that does to the features what demonstrations did nearby: locally weighted linear
  /// regression over their nearest transitions gives the control v_d that they took at `z` and the
  /// change dz_d that followed, least squares the control that causes this change today, |J v + m +
  /// s d - dz_d|^2 + 0.03 trace(J' J) / m |v - v_d|^2 -> min. So what turns or scales controls, or
  /// moves the world, is made up for as far as the estimate knows it. Takes what the last Compute()
  /// found, at its time step and z. O(n^3).
  /// @returns false, and leaves `v` (m entries), where nothing is known of demonstrated controls.
  [[nodiscard]] bool NominalControl(Eigen::VectorXd& v) noexcept;
  /// Whether NominalControl() only guesses: it neither explains how actions vary nor hits what they
  /// have in common. In the gallery's tasks `explained` is .29 and more, the least where each
  /// demonstrator has a pace of its own. Without a part of the state that the demonstrator looks
  /// at, a box, a velocity or a pole, it is .17 and less, and the error .46 and more. A
  /// demonstrator whose action is one and the same but for noise explains nothing, with an error of
  /// .2.
  /// @param explained  share of the variance of left-out actions that it explains.
  /// @param error  what it misses, squared, as a share of the squared actions.
  [[nodiscard]] static bool Guesses(double explained, double error) noexcept {
    constexpr double kLeastExplained = 0.2;
    constexpr double kMostError = 0.5;
    return explained < kLeastExplained && error > kMostError;
  }
  /// z += J v + m + s d of the last Compute(), where s is the time of `v`, or `time`.
  void AddEffect(const Eigen::Ref<const Eigen::VectorXd>& v, double time,
                 Eigen::Ref<Eigen::VectorXd> z) const noexcept;
  void AddEffect(const Eigen::Ref<const Eigen::VectorXd>& v,
                 // A view. NOLINTNEXTLINE(performance-unnecessary-value-param)
                 Eigen::Ref<Eigen::VectorXd> z) const noexcept {
    AddEffect(v, Time(v), z);
  }

  /// The control direction that is known least: the largest eigenvalue of A^-1 (of its part that
  /// belongs to v), its eigenvector to `direction` (m entries). Where the world moves by itself,
  /// its sign is the one that tells more: the same control again would leave the answer to it and
  /// the disturbance mixed up.
  double LeastExcitedDirection(std::span<double> direction) noexcept;
  /// The sum of its eigenvalues: an upper bound on the largest, for less time.
  [[nodiscard]] double UncertaintyBound() noexcept;

 private:
  void MoveTo(std::span<const double> z) noexcept;
  /// A_demo to a_, B_demo to demonstrated_.
  void AddDemonstrations() noexcept;
  /// b = A^-1 b with the factor of `cholesky_`; rows before `first` are left undefined.
  void Solve(core::Matrix& b, Eigen::Index first) const noexcept;

  std::shared_ptr<const TransitionStore> prior_;
  DisturbanceModel disturbance_model_;
  bool disturbed_;
  // Rows of A and B: [z' - z (n); 1; s; v (m)], the first n + 1 only with a drift, s only
  // with a disturbance.
  int drift_rows_;
  Eigen::MatrixXd a_online_;
  core::Matrix b_online_;      ///< E_on
  Eigen::VectorXd center_;     ///< z that A_on and E_on are about.
  core::Matrix demonstrated_;  ///< D of the last Compute().
  Eigen::MatrixXd a_;
  core::Matrix b_;
  Eigen::LLT<Eigen::MatrixXd> cholesky_;
  Eigen::MatrixXd inverse_;  ///< The last rows of A's: s and v.
  Eigen::MatrixXd jacobian_;
  Eigen::VectorXd disturbance_;
  Eigen::VectorXd drift_;
  Eigen::VectorXd regressor_;
  Eigen::VectorXd direction_;
  Eigen::VectorXd scratch_;
  TransitionStore::Workspace workspace_;
  bool has_sums_ = false;  ///< workspace_ holds those of the last Compute().
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
