#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <memory>
#include <span>

#include "dfr/control/guided/jacobian_prior.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// The time that a control v takes, s = rest + travel |v|, while the world moves by itself:
/// features then change by J v + s d. Its unit does not matter. Both 0: nothing else moves the
/// world.
struct DriftTime {
  double rest = 0.0;    ///< Whatever the control, >= 0.
  double travel = 0.0;  ///< An ordinary control's, >= 0.
};

/// Estimates how features change, dz = J v + m(z), without a model: J is the answer to controls,
/// m(z) = m + M (z' - z) the own motion of what goes on moving without one (mass, gravity). A
/// weighted least-squares fit of what the demonstrations did nearby and of every control that was
/// applied since; with w = [v; 1; z' - z],
///   A = diag(ridges) + A_demo + A_on,  B = B_demo + B_on,  [J m M] = (A^-1 B)',
///   after every applied control  A_on = f A_on + w w',  B_on = f B_on + w dz'
/// (recursive least squares with forgetting f; A_on and B_on move with z). The ridges of the own
/// motion are larger than that of J: what both explain is an answer to controls.
///
/// Where the world moves by itself, w has one more entry, the time s that the control took: the
/// drift d is told apart from the answer to controls; demonstrations were not disturbed, their s is
/// 0. Nothing after construction allocates.
class JacobianEstimate {
 public:
  /// @param own_motion  Off: nothing moves without a control, but for a drift.
  /// @throws std::invalid_argument if a time is negative or not finite.
  explicit JacobianEstimate(std::shared_ptr<const JacobianPrior> prior,
                            const DriftTime& drift_time = {}, bool own_motion = true);

  /// Forgets the applied controls.
  void Reset() noexcept;
  /// At features `z` the answer to control `v`, and what else went on for a time s = `time`, was
  /// `dz`; the measurement counts `weight` times, >= 0.
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
  [[nodiscard]] const Eigen::VectorXd& drift() const noexcept { return drift_; }
  /// m, n, of the last Compute(): what features do without a control.
  [[nodiscard]] const Eigen::VectorXd& own_motion() const noexcept { return own_motion_; }
  /// Whether Compute() was called since the last Update().
  [[nodiscard]] bool fresh() const noexcept { return fresh_; }
  /// s of control `v` (m entries).
  [[nodiscard]] double Time(const Eigen::Ref<const Eigen::VectorXd>& v) const noexcept {
    return drift_time_.rest + drift_time_.travel * v.norm();
  }
  /// The control that does to the features what demonstrations did nearby: locally weighted linear
  /// regression over their nearest transitions gives the control v_d that they took at `z` and the
  /// change dz_d that followed, least squares the control that causes this change today, |J v + m +
  /// s d - dz_d|^2 + 0.03 trace(J' J) / m |v - v_d|^2 -> min. So what turns or scales controls, or
  /// moves the world, is made up for as far as the estimate knows it. Takes what the last Compute()
  /// found, at its time step and z. O(n^3).
  /// @returns false, and leaves `v` (m entries), where nothing is known of demonstrated controls.
  [[nodiscard]] bool Demonstrated(Eigen::VectorXd& v) noexcept;
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
  /// the drift mixed up.
  double LeastKnown(std::span<double> direction) noexcept;
  /// The sum of its eigenvalues: an upper bound on the largest, for less time.
  [[nodiscard]] double Ignorance() noexcept;

 private:
  void MoveTo(std::span<const double> z) noexcept;
  void AddDemonstrations() noexcept;

  std::shared_ptr<const JacobianPrior> prior_;
  DriftTime drift_time_;
  bool drifts_;
  // Rows of A and B: [z' - z (n); 1; s; v (m)], the first n + 1 only with an own motion, s only
  // with a drift.
  int motion_rows_;
  Eigen::MatrixXd a_online_;
  core::Matrix b_online_;
  Eigen::VectorXd center_;  ///< z that A_on and B_on are about.
  Eigen::MatrixXd a_;
  core::Matrix b_;
  Eigen::LLT<Eigen::MatrixXd> cholesky_;
  Eigen::MatrixXd inverse_;  ///< The last rows of A's: s and v.
  Eigen::MatrixXd jacobian_;
  Eigen::VectorXd drift_;
  Eigen::VectorXd own_motion_;
  Eigen::VectorXd regressor_;
  Eigen::VectorXd direction_;
  Eigen::VectorXd scratch_;
  JacobianPrior::Workspace workspace_;
  bool has_sums_ = false;  ///< workspace_ holds those of the last Compute().
  bool fresh_ = false;

  // For Demonstrated().
  Eigen::MatrixXd a_demo_;
  Eigen::VectorXd unit_;  ///< n + 1
  Eigen::LLT<Eigen::MatrixXd> cholesky_demo_;
  Eigen::MatrixXd h_;
  Eigen::LLT<Eigen::MatrixXd> cholesky_controls_;
  Eigen::MatrixXd did_;     ///< m x 1
  Eigen::VectorXd wanted_;  ///< n
};

}  // namespace dfr::control
