#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <array>
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
  double motion_ridge = 1.0;   ///< Pulls the own motion at z to zero, > 0: controls explain first.
  double slope_ridge = 10.0;   ///< Pulls its slopes to zero, > 0.
  double prior_weight = 15.0;  ///< Total weight of the demonstrations' transitions, >= 0.
  int window = 5;              ///< Transitions of the time steps t - window ... t + window count.
  int max_per_step = 48;       ///< Most transitions kept of one time step: bounds the time.
  double forgetting = 0.93;    ///< Weight that an applied control keeps at the next, in [0, 1).
};

/// The time that a control v takes, s = rest + travel |v|, while the world moves by itself:
/// features then change by J v + s d. Its unit does not matter. Both 0: nothing else moves the
/// world.
struct DriftTime {
  double rest = 0.0;    ///< Whatever the control, >= 0.
  double travel = 0.0;  ///< An ordinary control's, >= 0.
};

/// Demonstrated transitions; immutable, shared by all estimates made from them.
///
/// Controls are v = u / us, us the root mean square of |u|, so that 1 is an ordinary control.
class JacobianPrior {
 public:
  /// Weights of transitions are exp(-kBandwidth |z_i - z|^2 / n), n features. Wider ones take J
  /// from where it is another, narrower ones from so few that it is noise.
  static constexpr double kBandwidth = 0.5;
  /// Transitions that say what demonstrations did, which depends on where; and more, kSpread, that
  /// say what J is, which varies little.
  static constexpr int kNearest = 64;
  static constexpr int kSpread = 264;

  /// One matrix of features (T_i + 1 x n) and of controls (T_i x m), in units of us, a
  /// demonstration. Transitions with a zero control are left out.
  /// @throws std::invalid_argument if shapes do not fit or an option is out of range.
  JacobianPrior(std::span<const core::Matrix> features, std::span<const core::Matrix> controls,
                const JacobianOptions& options);

  /// Appends all of it to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote, and what earlier versions did. Files of before version 3 do not tell
  /// controls from their negatives: has_controls() is then false.
  /// @throws std::runtime_error naming the file and what is wrong with it.
  static JacobianPrior Load(core::ArchiveReader& archive);

  [[nodiscard]] int feature_dim() const noexcept { return feature_dim_; }
  [[nodiscard]] int control_dim() const noexcept { return control_dim_; }
  [[nodiscard]] const JacobianOptions& options() const noexcept { return options_; }
  /// Whether the signs of demonstrated controls are known, without which the answer to them is, but
  /// neither the controls nor an own motion.
  [[nodiscard]] bool has_controls() const noexcept { return has_controls_; }

  /// Sums over the transitions near a time step and a state z, with r = [z_i - z; 1; v_i; dz_i] and
  /// weights w that fall with the distance to z and sum to prior_weight. To be made by
  /// MakeWorkspace().
  struct Workspace {
    Eigen::VectorXf z;  ///< Then zeros, to the width of a row.
    int first = 0;      ///< Transition,
    int rows = 0;       ///< and how many of them are near in time.
    Eigen::VectorXf distances;
    Eigen::VectorXd weights;  ///< One a transition, to be multiplied
    double factor = 1.0;      ///< by this, for sums that J is made from.
    Eigen::VectorXi spread;   ///< Those that J is made from,
    int used = 0;             ///< so many,
    Eigen::VectorXi nearest;  ///< and those nearest to z.
    Eigen::VectorXf left;     ///< w [v_i; z_i - z; 1], row by row.
    Eigen::VectorXf right;    ///< r, row by row.
    /// sum w v_i r' in the rows from 0, of which z_i - z is not asked for; sum w [z_i - z; 1] r' in
    /// those from `states`.
    Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> sums;
    int states = 0;
  };
  [[nodiscard]] Workspace MakeWorkspace() const;
  /// Sums over transitions near time step `t`, those of its last one where demonstrations end
  /// before, of v_i alone. @returns false if there is no transition, or z is not finite.
  bool SumControls(int t, std::span<const double> z, Workspace& workspace) const noexcept;
  /// Sums of [z_i - z; 1], after SumControls().
  void SumStates(Workspace& workspace) const noexcept;
  /// The same of the nearest transitions alone, with weights that sum to whatever they do.
  void SumNearStates(Workspace& workspace) const noexcept;

 private:
  static constexpr int kWithTransitions = 4;  ///< The first version of files that hold them.

  JacobianPrior() = default;
  void SumRows(const Eigen::VectorXi& indices, int count, double factor,
               Workspace& workspace) const noexcept;
  /// First and last transition, exclusive, of time steps t - window ... t + window.
  [[nodiscard]] std::pair<int, int> Near(int t) const noexcept;
  /// Entries of a row of transitions_.
  [[nodiscard]] int Width() const noexcept;
  core::Matrix OldTransitions(core::ArchiveReader& archive);
  /// Fills points_ and largest_, once transitions_ and begin_ are.
  void Finish();

  JacobianOptions options_;
  int feature_dim_ = 0;
  int control_dim_ = 0;
  bool has_controls_ = true;
  std::vector<int> begin_;  ///< Row at which time step t begins; one more entry at the end.
  int largest_ = 0;         ///< Most transitions that Near() gives.
  /// [z, 1, v, dz] of each transition in order of time, then zeros. In float, because sums over
  /// transitions are most of the work.
  Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> transitions_;
  Eigen::MatrixXf points_;  ///< The z of transitions_, by columns; then rows of zeros.
};

/// What a JacobianEstimate is to find out besides J.
struct EstimateScope {
  bool own_motion = true;  ///< Off: nothing moves without a control, but for a drift.
  bool lag = true;         ///< Off: controls act at once, and are seen at once.
  bool smoothing = true;   ///< Off: states are what is seen of them.
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
/// An effect may come a few controls late, or be seen late. The lag is the smallest one, up to
/// kMaxLag, whose predictions J v_{k - lag} were not far worse than those of the best. Controls are
/// then measured by what they did, and AddPending() predicts what those still under way will do.
///
/// Where the world moves by itself, w has one more entry, the time s that the control took: the
/// drift d is told apart from the answer to controls; demonstrations were not disturbed, their s is
/// 0. Nothing after construction allocates.
class JacobianEstimate {
 public:
  static constexpr int kMaxLag = 3;

  /// @throws std::invalid_argument if a time is negative or not finite.
  explicit JacobianEstimate(std::shared_ptr<const JacobianPrior> prior,
                            const DriftTime& drift_time = {}, const EstimateScope& scope = {});

  /// Forgets the applied controls.
  void Reset() noexcept;
  /// At features `z` control `v` was applied, and changed them by `dz`; the measurement counts
  /// `weight` times, >= 0. Looks for the lag if Compute() was called since the last Update().
  void Update(std::span<const double> z, std::span<const double> v, std::span<const double> dz,
              double weight = 1.0) noexcept;
  /// Computes J for time step `t` at `z`.
  void Compute(int t, std::span<const double> z) noexcept;

  /// J, n x m, of the last Compute().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return jacobian_; }
  /// d, n, of the last Compute(); 0 where nothing else moves the world.
  [[nodiscard]] const Eigen::VectorXd& drift() const noexcept { return drift_; }
  /// m, n, of the last Compute(): what features do without a control.
  [[nodiscard]] const Eigen::VectorXd& own_motion() const noexcept { return own_motion_; }
  /// How many controls after its own an effect is seen, in [0, kMaxLag].
  [[nodiscard]] int lag() const noexcept { return lag_; }
  /// The control that does to the features what demonstrations did nearby: locally weighted linear
  /// regression over their nearest transitions gives the control v_d that they took at `z` and the
  /// change dz_d that followed, least squares the control that causes this change today, |J v + m +
  /// s d - dz_d|^2 + 0.03 trace(J' J) / m |v - v_d|^2 -> min. So what turns or scales controls, or
  /// moves the world, is made up for as far as the estimate knows it. Takes what the last Compute()
  /// found, at its time step and z. O(n^3).
  /// @returns false, and leaves `v` (m entries), where nothing is known of demonstrated controls.
  [[nodiscard]] bool Demonstrated(Eigen::VectorXd& v) noexcept;
  /// z += J v + m + s d of the last Compute().
  void AddEffect(const Eigen::VectorXd& v, Eigen::Ref<Eigen::VectorXd> z) const noexcept;
  /// `z`, as it is seen, becomes an estimate of the state, between what is seen and what was
  /// expected of the last estimate. The residuals of Update() tell how noisy states are: noise of
  /// variance r in what is seen and q in what happens give them the variance 2 r + q and, from one
  /// to the next, the covariance -r. The weight of what is seen is the Kalman gain for q / r, at
  /// least 0.2, and 1 where they are not correlated so, or J was not asked for. Once after each
  /// Update(), and at first.
  void Smooth(Eigen::Ref<Eigen::VectorXd> z) noexcept;
  /// z += what the controls that are still under way will do, by the last Compute().
  void AddPending(Eigen::Ref<Eigen::VectorXd> z) const noexcept;

  /// The control direction that is known least: the largest eigenvalue of A^-1 (of its part that
  /// belongs to v), its eigenvector to `direction` (m entries). Where the world moves by itself,
  /// its sign is the one that tells more: the same control again would leave the answer to it and
  /// the drift mixed up.
  double LeastKnown(std::span<double> direction) noexcept;
  /// The sum of its eigenvalues: an upper bound on the largest, for less time.
  [[nodiscard]] double Ignorance() noexcept;

 private:
  [[nodiscard]] double Time(double norm) const noexcept {
    return drift_time_.rest + drift_time_.travel * norm;
  }
  [[nodiscard]] int FindLag(std::span<const double> dz, double time) noexcept;
  void MoveTo(std::span<const double> z) noexcept;
  void AddDemonstrations() noexcept;

  std::shared_ptr<const JacobianPrior> prior_;
  DriftTime drift_time_;
  EstimateScope scope_;
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

  Eigen::MatrixXd applied_;                   ///< m x (kMaxLag + 1), the newest first.
  std::array<double, kMaxLag + 1> errors_{};  ///< Squared, of each lag's predictions.
  bool fresh_ = false;                        ///< No Update() since the last Compute().
  int lag_ = 0;

  // For Smooth().
  Eigen::VectorXd residual_;  ///< The last Update()'s, or 0.
  double power_ = 0.0;        ///< Squared residuals, with forgetting,
  double correlation_ = 0.0;  ///< and their products from one to the next.
  double travel_ = 0.0;       ///< Squared changes.
  Eigen::VectorXd expected_;  ///< The last estimate, after Update() with what was expected of it.
  bool expects_ = false;

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
