#pragma once

#include <Eigen/Core>
#include <span>
#include <utility>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// Options for TransitionStore and its ResponseEstimate.
struct ResponseOptions {
  double ridge = 0.02;         ///< Ridge of J, > 0.
  double drift_ridge = 1.0;    ///< Ridge of the drift at z and of its slopes, > 0.
  double slope_ridge = 10.0;   ///< Ridge of the drift's slopes for controls of the episode, > 0.
  double prior_weight = 15.0;  ///< Total weight of the demonstrations' transitions, >= 0.
  int window = 5;              ///< Uses transitions with u != 0 of the time steps t - window ...
                               ///< t + window, or the nearest in time if there are none.
  int max_per_step = 48;     ///< Maximum number of transitions per time step; bounds the run time.
  double forgetting = 0.93;  ///< Factor on the weight of earlier controls, in [0, 1).
  /// LocalFit::NominalControl() aims at the measured changes of features in demonstrations.
  /// Response sets false if these changes are too noisy.
  bool measured_changes = true;
};

/// Demonstrated transitions. Immutable; estimates share them.
///
/// Controls are v = u / us, where `us` is the root mean square of |u|: |v| = 1 is an ordinary
/// control.
class TransitionStore {
 public:
  /// Weights of transitions are exp(-kBandwidth |z_i - z|^2 / n) with n features. Wider weights mix
  /// regions with different J; narrower weights leave too few transitions.
  static constexpr double kBandwidth = 0.5;
  /// Maximum number of transitions: kNearest for the demonstrated control, which depends strongly
  /// on z, and kSpread for J, which varies little.
  static constexpr int kNearest = 64;
  static constexpr int kSpread = 264;

  /// @param features  one matrix (T_i + 1 x n) per demonstration.
  /// @param controls  one matrix (T_i x m) per demonstration, in units of us. Ignores zero
  ///   controls.
  /// @param contexts  one matrix (T_i x k, or with more rows) per demonstration: quantities, in
  /// addition to z, on which a control depends. In their units, 1 is a relevant difference.
  /// Empty: k is 0.
  /// @throws std::invalid_argument if shapes do not match or an option is out of range.
  TransitionStore(std::span<const core::Matrix> features, std::span<const core::Matrix> controls,
                  const ResponseOptions& options, std::span<const core::Matrix> contexts = {});

  /// Appends this object to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and its defect.
  static TransitionStore Load(core::ArchiveReader& archive);

  [[nodiscard]] int feature_dim() const noexcept { return feature_dim_; }
  [[nodiscard]] int control_dim() const noexcept { return control_dim_; }
  [[nodiscard]] int context_dim() const noexcept { return static_cast<int>(contexts_.cols()); }
  [[nodiscard]] const ResponseOptions& options() const noexcept { return options_; }
  /// Returns the mean of |dz|^2 over all transitions, or 0 if there are none.
  [[nodiscard]] double mean_square_change() const noexcept { return mean_square_change_; }

  /// Returns true if sums at `z` do not overflow in float. They overflow only if |z| exceeds 1e18.
  /// FitAt() cannot use demonstrations at such a z.
  [[nodiscard]] bool Reaches(std::span<const double> z) const noexcept;

  /// Returns true if `z` is in the bounding box of all demonstrated states, enlarged on each side
  /// by its diagonal. A demonstrated action cannot lead from a demonstrated state out of this box.
  [[nodiscard]] bool Surrounds(std::span<const double> z) const noexcept;

  /// Sums over the transitions near a time step and a state z, with r = [z_i - z; 1; v_i; dz_i] and
  /// weights w that decrease with the distance to z and sum to prior_weight. Create it with
  /// MakeWorkspace().
  struct Workspace {
    Eigen::VectorXf z;  ///< Padded with zeros to the width of a row.
    int first = 0;      ///< First transition with a nearby time step.
    int rows = 0;       ///< Number of transitions with a nearby time step.
    Eigen::VectorXf distances;
    float least = 0.0F;       ///< Smallest distance.
    Eigen::VectorXi spread;   ///< Indices of the transitions for J: every stride-th one.
    Eigen::VectorXd weights;  ///< Weights of `spread`, without `factor`.
    int used = 0;             ///< Number of entries of `spread`.
    int stride = 1;
    double factor = 1.0;           ///< Factor of the weights in sums for J.
    Eigen::VectorXi nearest;       ///< Indices of the nearest transitions to z.
    Eigen::VectorXd near_weights;  ///< Weights of `nearest`.
    Eigen::VectorXf tile;          ///< Scratch: some rows w [v_i; z_i - z; 1] and r.
    /// sum w v_i r' in the rows from 0, without the columns of z_i - z, and sum w [z_i - z; 1] r'
    /// in the rows from `states`.
    Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> sums;
    int states = 0;
    Eigen::VectorXf residual;  ///< One factor per column of r, padded; see Share().
  };
  [[nodiscard]] Workspace MakeWorkspace() const;
  /// Returns the distance from z to the nearest state of a transition at any time step, or
  /// NaN if z is not finite or Reaches() is false. Changes `workspace`.
  [[nodiscard]] double Distance(std::span<const double> z, Workspace& workspace) const noexcept;
  /// Computes the sums of v_i over transitions near time step `t`, or near the last time step if
  /// `t` is later. @returns false if there is no transition or z is not finite.
  bool SumControls(int t, std::span<const double> z, Workspace& workspace) const noexcept;
  /// Computes the sums of [z_i - z; 1]. Call it after SumControls().
  void SumStates(Workspace& workspace) const noexcept;
  /// Same as SumStates() over the nearest transitions only, without normalisation of the weights.
  /// The distance of a transition includes the distance of its context c_i from c = `context`
  /// (context_dim() entries): weights are exp(-kBandwidth |z_i - z|^2 / n - |c_i - c|^2).
  void SumNearStates(Workspace& workspace, const Eigen::VectorXf& context) const noexcept;
  /// Returns S / (S + R), or 1 if both are 0. S is the weighted sum of (`gain` v_k)^2 with entry k
  /// of the controls. R is the weighted sum of (c' [z_i; 1; v_i; dz_i])^2 with c in
  /// workspace.residual. Both are sums over every guided::kAgreementStride-th transition that
  /// SumControls() used last.
  [[nodiscard]] double Share(Eigen::Index k, double gain,
                             const Workspace& workspace) const noexcept;

 private:
  TransitionStore() = default;
  void SumRows(const Eigen::VectorXi& indices, const Eigen::VectorXd& weights, int count,
               double factor, Workspace& workspace) const noexcept;
  /// Returns the range [first, last) of the transitions within ResponseOptions::window of t.
  [[nodiscard]] std::pair<int, int> Near(int t) const noexcept;
  /// Returns the number of entries of a row of transitions_.
  [[nodiscard]] int Width() const noexcept;
  /// Fills points_, largest_, mean_square_change_ and the box from transitions_ and begin_.
  void Finish();

  ResponseOptions options_;
  int feature_dim_ = 0;
  int control_dim_ = 0;
  std::vector<int> begin_;    ///< First row of time step t; one more entry at the end.
  Eigen::MatrixXf contexts_;  ///< One row per transition.
  double mean_square_change_ = 0.0;
  int largest_ = 0;  ///< Maximum number of transitions in Near().
  /// [z, 1, v, dz] of each transition in time order, padded with zeros. In float, because sums over
  /// transitions take most of the time.
  Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> transitions_;
  Eigen::MatrixXf points_;  ///< The z of transitions_, by columns; then rows of zeros.
  Eigen::VectorXd lowest_;  ///< Corners of the enlarged box.
  Eigen::VectorXd highest_;
};

}  // namespace dfr::control
