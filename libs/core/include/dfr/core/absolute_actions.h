#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "dfr/core/features.h"
#include "dfr/core/trajectory.h"

namespace dfr::core {

/// An entry of the actions that is a target position: it takes the values of a state's entry.
struct AbsoluteAction {
  int action = 0;            ///< Entry of the actions.
  int state = 0;             ///< Entry of the states that it follows.
  bool leads = true;         ///< False where it only repeats the state that it was recorded in.
  double correlation = 0.0;  ///< With that entry, at the step or the one after it.
  double slope = 0.0;        ///< Action over that entry; 1 for a target.
};

/// Tells target positions from velocities and increments, over the episodes of a set.
///
/// Action u_k is taken to be a target for entry x_j of the state if u_k(t) equals x_j(t) or
/// x_j(t + 1) up to noise (slope within 0.1 of one, correlation of at least 0.9, offset below half
/// the spread), and u_k(t) - x_j(t) moves x_j that way. Where the actions themselves, rather than
/// these differences, explain how an unmatched entry of the state changes, they are velocities and
/// x_j shows them: its own velocity, or the last action.
///
/// Memory and time per step grow with the square of state and action entries together.
class ActionAnalysis {
 public:
  ActionAnalysis(int state_dim, int control_dim);

  /// States (T + 1) x state_dim, controls T x control_dim, all finite.
  void Add(const Trajectory& episode);

  /// The entries that are targets, in the order of the actions.
  [[nodiscard]] std::vector<AbsoluteAction> Absolute() const;

 private:
  [[nodiscard]] bool MovesUnmatchedEntry(const std::vector<AbsoluteAction>& candidates) const;

  Eigen::Index n_;
  Eigen::Index m_;
  double count_ = 0.0;
  // Sums over all steps of (u(t), x(t), x(t + 1)) and of its products.
  Eigen::VectorXd sum_;
  Eigen::MatrixXd products_;
};

/// Analyses a whole set at once.
[[nodiscard]] std::vector<AbsoluteAction> FindAbsoluteActions(
    std::span<const Trajectory> demonstrations);

/// Makes increments of targets: u_k(t) - x_j(t), or x_j(t + 1) - x_j(t) where the action does not
/// lead. Other entries stay as they are.
void ToDifferences(std::span<const AbsoluteAction> absolute, Trajectory& episode);

/// One sentence for an error or a warning: "actions 0, 1 take the values of joint[0], joint[1]
/// (correlation .998, slope 1.00): they are positions".
[[nodiscard]] std::string Describe(std::span<const AbsoluteAction> absolute,
                                   const StateLayout& layout);

/// "object[2]": the entry of a state as users name it.
[[nodiscard]] std::string EntryName(const StateLayout& layout, Eigen::Index entry);

}  // namespace dfr::core
