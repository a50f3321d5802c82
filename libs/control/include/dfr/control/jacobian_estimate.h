#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "dfr/core/archive.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// Options for JacobianEstimate.
struct JacobianOptions {
  double ridge = 0.02;         ///< Pulls J to zero where nothing is known, > 0.
  double prior_weight = 15.0;  ///< Total weight of the demonstrations' transitions, >= 0.
  int window = 5;              ///< Transitions of the time steps t - window ... t + window count.
  int max_per_step = 12;       ///< Most transitions kept of one time step: bounds the time.
  double forgetting = 0.93;    ///< Weight that an applied control keeps at the next, in [0, 1).
};

/// The time that a control v takes, s = rest + travel |v|, while the world moves by itself:
/// features then change by J v + s d. Its unit does not matter. Both 0: nothing else moves the
/// world.
struct DriftTime {
  double rest = 0.0;    ///< Whatever the control, >= 0.
  double travel = 0.0;  ///< Of an ordinary control, >= 0.
};

/// What demonstrated transitions say of J; immutable, shared by all estimates made from it.
///
/// Controls are v = u / us, us the root mean square of |u|, so that 1 is an ordinary control.
class JacobianPrior {
 public:
  /// One matrix of features (T_i + 1 x n) and of controls (T_i x m), in units of us, a
  /// demonstration. Transitions with a zero control are left out.
  /// @throws std::invalid_argument if shapes do not fit or an option is out of range.
  JacobianPrior(std::span<const core::Matrix> features, std::span<const core::Matrix> controls,
                const JacobianOptions& options);

  /// Appends all of it to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. Files of before version 3 hold no controls: AddDemonstrated() then
  /// adds nothing. @throws std::runtime_error naming the file and what is wrong with it.
  static JacobianPrior Load(core::ArchiveReader& archive);

  [[nodiscard]] int feature_dim() const noexcept { return feature_dim_; }
  [[nodiscard]] int control_dim() const noexcept { return control_dim_; }
  [[nodiscard]] const JacobianOptions& options() const noexcept { return options_; }

  /// Adds sum w v v' to `a` (its lower triangle) and sum w v dz' to `b` (m x n), over transitions
  /// near time step `t`, w falling with the distance to `z` and summing to prior_weight. `sums` is
  /// room for num_sums() entries. Sums are in single precision, which leaves J to about 1e-6.
  void AddTo(int t, std::span<const double> z, Eigen::VectorXf& sums, Eigen::MatrixXd& a,
             Eigen::MatrixXd& b) const noexcept;
  [[nodiscard]] Eigen::Index num_sums() const noexcept { return products_.cols(); }
  /// Adds sum w y y' to `a` (its lower triangle, (n + 1) x (n + 1)) and sum w y v' to `b`
  /// ((n + 1) x m), y = [1; z_i - z], over transitions near time step `t`, those from the last one
  /// on where demonstrations end before. The nearest one has w = 1. @returns the sum of w.
  double AddDemonstrated(int t, std::span<const double> z, Eigen::VectorXd& y, Eigen::MatrixXd& a,
                         Eigen::MatrixXd& b) const noexcept;

 private:
  JacobianPrior() = default;
  /// First and last transition, exclusive, of time steps t - window ... t + window.
  [[nodiscard]] std::pair<int, int> Near(int t) const noexcept;

  JacobianOptions options_;
  int feature_dim_ = 0;
  int control_dim_ = 0;
  std::vector<int> begin_;  ///< Row at which time step t begins; one more entry at the end.
  // In float, for the sums over transitions are most of the work.
  Eigen::MatrixXf points_;    ///< z of each transition, in order of time,
  Eigen::MatrixXf controls_;  ///< and v. Without rows where a file does not hold them.
  /// Lower triangle of v v', then v dz', of each.
  Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> products_;
};

/// Estimates how features answer a control, dz = J v, without a model: a weighted least-squares fit
/// of what the demonstrations did nearby and of every control that was applied since,
///   A = ridge I + A_demo + A_on,  B = B_demo + B_on,  J = (A^-1 B)',
///   after every applied control  A_on = f A_on + v v',  B_on = f B_on + v dz'.
/// (recursive least squares with forgetting f). Where the world moves by itself, w = [v; s] takes
/// the place of v, so that the drift d is told apart from the answer to controls; demonstrations
/// were not disturbed, their s is 0. Nothing after construction allocates.
class JacobianEstimate {
 public:
  /// @throws std::invalid_argument if a time is negative or not finite.
  explicit JacobianEstimate(std::shared_ptr<const JacobianPrior> prior,
                            const DriftTime& drift_time = {});

  /// Forgets the applied controls.
  void Reset() noexcept;
  /// Control `v` changed the features by `dz`; the measurement counts `weight` times, >= 0.
  void Update(std::span<const double> v, std::span<const double> dz, double weight = 1.0) noexcept;
  /// Computes J for time step `t` at `z`.
  void Compute(int t, std::span<const double> z) noexcept;

  /// J, n x m, of the last Compute().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return jacobian_; }
  /// d, n, of the last Compute(); 0 where nothing else moves the world.
  [[nodiscard]] const Eigen::VectorXd& drift() const noexcept { return drift_; }
  /// The control that does to the features what demonstrations did nearby: locally weighted linear
  /// regression gives the control v_d that demonstrations took at `z` in time step `t`, their
  /// transitions alone what it did to the features there, J_demo v_d, and least squares the control
  /// whose effect is that today, |J v + s d - J_demo v_d|^2 + 0.03 trace(J' J) / m |v - v_d|^2
  /// -> min. So what turns or scales controls, or moves the world, is made up for as far as J knows
  /// it. Takes J of the last Compute(), which was for the same `t` and `z`. O(n^3).
  /// @returns false, and leaves `v` (m entries), where nothing is known of demonstrated controls.
  [[nodiscard]] bool Demonstrated(int t, std::span<const double> z, Eigen::VectorXd& v) noexcept;
  /// z += J v + s d of the last Compute().
  void AddEffect(const Eigen::VectorXd& v, Eigen::Ref<Eigen::VectorXd> z) const noexcept;

  /// The control direction that is known least: the largest eigenvalue of A^-1 (of its part that
  /// belongs to v), its eigenvector to `direction` (m entries). Where the world moves by itself,
  /// its sign is the one that tells more: the same control again would leave the answer to it and
  /// the drift mixed up.
  double LeastKnown(std::span<double> direction) noexcept;
  /// The sum of its eigenvalues: an upper bound on the largest, for less time.
  [[nodiscard]] double Ignorance() const noexcept;

 private:
  [[nodiscard]] double Time(double norm) const noexcept {
    return drift_time_.rest + drift_time_.travel * norm;
  }

  std::shared_ptr<const JacobianPrior> prior_;
  DriftTime drift_time_;
  bool drifts_;
  Eigen::MatrixXd a_online_;
  Eigen::MatrixXd b_online_;
  Eigen::MatrixXd a_;
  Eigen::MatrixXd b_;
  Eigen::LLT<Eigen::MatrixXd> cholesky_;
  Eigen::MatrixXd inverse_;
  Eigen::MatrixXd jacobian_;
  Eigen::VectorXd drift_;
  Eigen::VectorXd regressor_;
  Eigen::VectorXd direction_;
  Eigen::VectorXd scratch_;
  Eigen::VectorXf sums_;
  // Of Demonstrated(): its regression, and the least squares of what it did.
  Eigen::VectorXd y_;
  Eigen::MatrixXd unit_;  ///< (n + 1) x 1
  Eigen::MatrixXd a_demo_;
  Eigen::MatrixXd b_demo_;
  Eigen::LLT<Eigen::MatrixXd> cholesky_demo_;
  Eigen::MatrixXd h_;
  Eigen::LLT<Eigen::MatrixXd> cholesky_controls_;
  Eigen::MatrixXd did_;  ///< m x 1
  Eigen::VectorXd wanted_;
};

}  // namespace dfr::control
