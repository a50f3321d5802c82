#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/features/features.h"
#include "dfr/core/features/rotations.h"
#include "dfr/core/trajectory.h"

namespace dfr::core {

/// An action entry that is a target position for one entry of the state.
struct AbsoluteAction {
  int action = 0;  ///< Index of the action entry.
  int state = 0;   ///< Index of the state entry for which the action is a target.
  /// False if the action only repeats the state with which it was recorded.
  bool leads = true;
  double correlation = 0.0;  ///< Correlation with the state entry at the same or the next step.
  double slope = 0.0;        ///< Slope of the action against the same state entry; 1 for a target.
  double period = 0.0;       ///< Period of the state entry if it is an angle that jumps; else 0.
};

/// Distinguishes target positions from velocities and increments in a set of episodes.
///
/// Action u_k counts as a target for state entry x_j if two conditions hold. First, u_k(t) equals
/// x_j(t) or x_j(t + 1) up to noise: slope within 0.1 of one, correlation at least 0.9, offset
/// below half the spread. Second, u_k(t) - x_j(t) moves x_j in its direction or is zero. If the
/// actions themselves explain at least 80 % of the changes of an unmatched state entry, the actions
/// are velocities, and x_j is a measured velocity or a copy of the last action.
///
/// An action entry with few values, such as a gripper that opens or closes, is a target only if all
/// entries of actions have few values, and x_j has more. Flags in the state have few values.
///
/// A state entry x_j counts as a copy of a recent action, not as a position, if two conditions
/// hold. First, x_j(t + 1) equals u_k(t - i) at every step, for an i up to 3. This also holds for a
/// position that follows its target perfectly. Second, u_k moves another entry, which repeats no
/// action, as a velocity does: u_k(t - l), for an l up to 3, explains at least half of the entry's
/// change that the other actions leave unexplained. The part that u_k(t - l) leaves unexplained is
/// at most half of the part that any difference u_k(t - l) - u_k(t - l - 1) leaves unexplained.
/// Targets move a robot by their differences. If at least half of a block of entries counts as
/// copies, and the block repeats all entries of the action in their order, the whole block counts
/// as copies.
///
/// Memory and time per step are linear in the number of state entries.
class ActionAnalysis {
 public:
  ActionAnalysis(int state_dim, int control_dim);

  /// Adds an episode: states (T + 1) x state_dim, controls T x control_dim, all finite.
  void Add(const Trajectory& episode);

  /// Returns the entries that are targets, in the order of the actions.
  [[nodiscard]] std::vector<AbsoluteAction> Absolute() const;

 private:
  static constexpr Eigen::Index kMostLag = 3;
  static constexpr std::size_t kMostFew = 4;
  [[nodiscard]] bool MovesUnmatchedEntry(const std::vector<AbsoluteAction>& candidates) const;
  void AddHistory(const Trajectory& episode);
  void AddValues(const Matrix& rows, std::size_t first);
  /// Returns true if values_[i] are few, each repeated several times on average.
  [[nodiscard]] bool HasFewValues(std::size_t i) const;
  /// Returns true for state entries that repeat an action which moves another entry.
  [[nodiscard]] std::vector<bool> FindPastActions() const;
  /// Takes, for each state entry, the variance of its change that the other action entries leave
  /// unexplained. Returns the share of this variance that action entry `k` explains. Uses the
  /// actions u(t - lag), or u(t - lag) - u(t - lag - 1) if `difference`.
  [[nodiscard]] Eigen::VectorXd ExplainedBy(Eigen::Index k, Eigen::Index lag,
                                            bool difference) const;

  Eigen::Index n_;
  Eigen::Index m_;
  double count_ = 0.0;
  // Sums of u(t) and of u(t) u(t)' over all steps.
  Eigen::VectorXd actions_;
  Eigen::MatrixXd action_products_;
  // One column per entry of x(t), then per entry of x(t + 1): its sum, the sum of its squares, and
  // the sums of its products with u(t).
  Eigen::VectorXd sum_;
  Eigen::VectorXd squares_;
  Eigen::MatrixXd products_;
  // Sum of x_j(t) x_j(t + 1).
  Eigen::VectorXd steps_;
  // One block of m rows for each lag i: the largest |x_j(t + 1) - u_k(t - i)| over all steps.
  Eigen::MatrixXd deviations_;
  Eigen::VectorXd largest_;  // Largest |u_k|.
  // At most kMostFew + 1 different values of each entry of u(t), then of each entry of x(t).
  std::vector<std::vector<double>> values_;
  // Sums of h, h h', h dx', dx and the squares of dx over the steps from kMostLag + 1 on, with
  // h = [u(t); ...; u(t - kMostLag - 1)] and dx = x(t + 1) - x(t).
  double history_count_ = 0.0;
  Eigen::VectorXd history_;
  Eigen::MatrixXd history_products_;
  Eigen::MatrixXd history_changes_;
  Eigen::VectorXd changes_;
  Eigen::VectorXd change_squares_;
  RotationFinder angles_;  // Treats each state entry separately.
};

/// Returns the targets in a set of demonstrations; empty if the set is empty.
[[nodiscard]] std::vector<AbsoluteAction> FindAbsoluteActions(
    std::span<const Trajectory> demonstrations);

/// Converts targets to increments: u_k(t) - x_j(t), or x_j(t + 1) - x_j(t) if `leads` is false. An
/// increment of an angle that jumps lies within half a period of 0. Does not change other entries.
void ToDifferences(std::span<const AbsoluteAction> absolute, Trajectory& episode);

/// Returns one sentence for an error or a warning: "actions 0, 1 take the values of joint[0],
/// joint[1] (correlation at least 0.998, slope 0.98): they are positions". The sentence gives the
/// slope that is furthest from 1.
[[nodiscard]] std::string Describe(std::span<const AbsoluteAction> absolute,
                                   const StateLayout& layout);

/// Returns the user's name of a state entry, for example "object[2]".
[[nodiscard]] std::string EntryName(const StateLayout& layout, Eigen::Index entry);

}  // namespace dfr::core
