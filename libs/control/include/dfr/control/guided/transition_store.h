#pragma once

#include <Eigen/Core>
#include <span>
#include <utility>
#include <vector>

#include "dfr/core/archive.h"
#include "dfr/core/matrix.h"

namespace dfr::control {

/// Options for TransitionStore, and for the ResponseEstimate that begins with it.
struct ResponseOptions {
  double ridge = 0.02;         ///< Pulls J to zero where nothing is known, > 0.
  double drift_ridge = 1.0;    ///< Pulls the drift at z to zero, > 0: controls explain first.
  double slope_ridge = 10.0;   ///< Pulls its slopes to zero, > 0.
  double prior_weight = 15.0;  ///< Total weight of the demonstrations' transitions, >= 0.
  int window = 5;              ///< Transitions of the time steps t - window ... t + window count.
  int max_per_step = 48;       ///< Most transitions kept of one time step: bounds the time.
  double forgetting = 0.93;    ///< Weight that an applied control keeps at the next, in [0, 1).
};

/// Demonstrated transitions; immutable, shared by all estimates made from them.
///
/// Controls are v = u / us, us the root mean square of |u|, so that 1 is an ordinary control.
class TransitionStore {
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
  TransitionStore(std::span<const core::Matrix> features, std::span<const core::Matrix> controls,
                  const ResponseOptions& options);

  /// Appends all of it to a file.
  void Save(core::ArchiveWriter& archive) const;
  /// Reads what Save() wrote. @throws std::runtime_error naming the file and what is wrong with it.
  static TransitionStore Load(core::ArchiveReader& archive);

  [[nodiscard]] int feature_dim() const noexcept { return feature_dim_; }
  [[nodiscard]] int control_dim() const noexcept { return control_dim_; }
  [[nodiscard]] const ResponseOptions& options() const noexcept { return options_; }

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
  TransitionStore() = default;
  void SumRows(const Eigen::VectorXi& indices, int count, double factor,
               Workspace& workspace) const noexcept;
  /// First and last transition, exclusive, of time steps t - window ... t + window.
  [[nodiscard]] std::pair<int, int> Near(int t) const noexcept;
  /// Entries of a row of transitions_.
  [[nodiscard]] int Width() const noexcept;
  /// Fills points_ and largest_, once transitions_ and begin_ are.
  void Finish();

  ResponseOptions options_;
  int feature_dim_ = 0;
  int control_dim_ = 0;
  std::vector<int> begin_;  ///< Row at which time step t begins; one more entry at the end.
  int largest_ = 0;         ///< Most transitions that Near() gives.
  /// [z, 1, v, dz] of each transition in order of time, then zeros. In float, because sums over
  /// transitions are most of the work.
  Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> transitions_;
  Eigen::MatrixXf points_;  ///< The z of transitions_, by columns; then rows of zeros.
};

}  // namespace dfr::control
