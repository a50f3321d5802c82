#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/safety/guard_advice.h"
#include "dfr/safety/guard_model.h"

/// Replays recorded episodes through a guard.
namespace dfr::apps::guard {

struct ReplayedEpisode {
  std::string name;
  std::vector<double> levels;
  double lowest = 0.0;
  double inside = 0.0;   ///< Share of states inside the support.
  int first_alarm = -1;  ///< Step, or -1.
  int passing = 0;       ///< Number of actions that a certificate passes.
  safety::Shadow shadow = {};
};

/// Opens episodes to replay.
/// @throws std::runtime_error naming the file if their states or actions are not the guard's.
std::unique_ptr<imitation::DemonstrationReader> OpenEpisodes(const safety::GuardModel& model,
                                                             const std::filesystem::path& path,
                                                             const std::string& filter_key);

/// Returns true if the guard's file contains the data that a certificate needs.
bool CanCertify(const safety::GuardModel& model);

/// Influence of each entry of a state on l: the mean of |dl/dx| times the standard deviation of
/// that entry over demonstrations at the same time.
class Drivers {
 public:
  explicit Drivers(const safety::GuardModel& model)
      : model_(&model), sums_(Eigen::VectorXd::Zero(model.task_layout().state_dim())) {}

  void Add(const core::Matrix& states, const std::vector<int>& steps);

  /// Returns the share and index of each state entry that a feature uses, largest share first.
  [[nodiscard]] std::vector<std::pair<double, int>> Ranked() const;

 private:
  [[nodiscard]] Eigen::VectorXd Spread() const;

  const safety::GuardModel* model_;
  Eigen::VectorXd sums_;
  std::vector<core::Matrix> states_;
};

/// Distances of states from a guard's support vectors, the demonstrated states that it keeps. For a
/// state that raises no alarm, none of these distances exceeds safety::Clearances().
class Strays {
 public:
  explicit Strays(const safety::GuardModel& model);

  /// Adds states of model.task_layout(), one per row, at these time steps of the support. A state
  /// with a nonfinite entry has no distance.
  void Add(const core::Matrix& states, const std::vector<int>& steps);

  /// Returns the distances of all states for each block that features use, in the block's unit. The
  /// distance is to the support vector that is nearest in whitened features.
  [[nodiscard]] std::map<std::string, std::vector<double>> Distances() const;

 private:
  const safety::GuardModel* model_;
  std::vector<std::vector<Eigen::VectorXd>> features_;  // [time step]
};

/// Receives the states of an episode, in model.task_layout(), and their time steps of the support.
using SeeStates = std::function<void(const core::Matrix& states, const std::vector<int>& steps)>;

/// Follows each episode of a file, without applying the guard's actions.
/// @param see  called for each episode; may be empty.
/// @throws std::runtime_error naming the file if it has no episode or a layout unlike the guard's.
std::vector<ReplayedEpisode> Replay(const std::shared_ptr<const safety::GuardModel>& shared,
                                    const std::filesystem::path& path,
                                    const std::string& filter_key, const SeeStates& see);

}  // namespace dfr::apps::guard
