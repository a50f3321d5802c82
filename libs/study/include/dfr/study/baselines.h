#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/core/plant.h"
#include "dfr/core/policy.h"
#include "dfr/core/trajectory.h"
#include "dfr/imitation/demonstrations.h"
#include "dfr/imitation/fit_mlp.h"
#include "dfr/safety/task_model.h"

namespace dfr::study {

/// Inputs of baselines that train new policies.
struct Expert {
  /// Fits the program's learner to all state-control pairs, with the learned policy's settings
  /// except the seed. Empty: no baseline can train a policy.
  std::function<std::unique_ptr<const core::Policy>(std::span<const core::Trajectory>,
                                                    std::uint64_t seed)>
      learn = {};
  std::uint64_t seed = 0;  ///< Seed of all randomness in these baselines.
  /// Plant for the supervisor's demonstrations; cloned before use. Null: no supervisor is
  /// available.
  std::shared_ptr<const core::SimulatedPlant> plant = nullptr;
  /// Writes to `u` the supervisor's control for the plant's current state at time step t, without
  /// the supervisor's noise. The episode's seed selects the supervisor's variation.
  std::function<void(const core::SimulatedPlant& plant, int t, std::uint64_t episode,
                     std::span<double> u)>
      supervise = {};
  int horizon = 0;  ///< Maximum number of supervised controls per episode; 0: the task's horizon.
};

/// Returns an Expert that uses imitation::FitMlp() on sets with the layout of `like`, with
/// `options` except the seed. The caller provides the supervisor.
[[nodiscard]] Expert TeachMlp(const imitation::DemonstrationSet& like,
                              const imitation::FitMlpOptions& options);

/// Mean of five policies, each learned from demonstrations sampled with replacement. Immutable;
/// concurrent calls are safe.
class EnsemblePolicy final : public core::Policy {
 public:
  static constexpr int kMembers = 5;
  static constexpr int kMostControls = 32;

  /// @throws std::invalid_argument if `teaching` cannot train policies, or controls have more than
  ///   kMostControls entries.
  EnsemblePolicy(const Expert& teaching, std::span<const core::Trajectory> demonstrations);
  [[nodiscard]] int state_dim() const noexcept override { return members_[0]->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return members_[0]->control_dim(); }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override {
    static_cast<void>(Mean(t, x, u));
  }
  /// Same as Control(); also returns the root mean square distance of the members from their mean.
  double Mean(int t, std::span<const double> x, std::span<double> u) const noexcept;
  /// Largest disagreement in a demonstrated state.
  [[nodiscard]] double demonstrated_disagreement() const noexcept { return demonstrated_; }

 private:
  std::vector<std::unique_ptr<const core::Policy>> members_;
  double demonstrated_ = 0.0;
};

/// Returns a controller that applies the ensemble's mean. It halts (HaltCause::kEarlyStopping) if
/// the members disagree more than in any demonstrated state, and after `horizon` controls.
/// EnsembleDAgger (Menda et al., IROS 2019) gates a learner by the same test but hands over to the
/// supervisor.
[[nodiscard]] std::unique_ptr<control::Controller> MakeEnsembleController(
    std::shared_ptr<const EnsemblePolicy> ensemble, int horizon);

/// DART (Laskey et al., CoRL 2017). Collects as many demonstrations as there are in
/// `demonstrations`, with normal noise added to the supervisor's controls. The noise has the
/// covariance of the learned policy's errors on ten episodes of the supervisor. The policy learns
/// the supervisor's controls without the noise. Discards demonstrations that do not complete the
/// task within `horizon` controls.
/// @throws std::invalid_argument if there is no supervisor, or it completes fewer than 1 in 10
///   episodes.
[[nodiscard]] std::unique_ptr<const core::Policy> TrainDart(
    const Expert& teaching, const core::Policy& learned,
    std::span<const core::Trajectory> demonstrations, int horizon);

/// DAgger (Ross et al., AISTATS 2011) in ten rounds. In each round the current policy runs, the
/// supervisor labels every visited state, and the next policy learns from all states so far. The
/// rounds together use as many episodes as there are demonstrations. Only this method runs
/// unfinished policies, which may collide during training.
/// @throws std::invalid_argument if there is no supervisor.
[[nodiscard]] std::unique_ptr<const core::Policy> TrainDagger(
    const Expert& teaching, const core::Policy& learned,
    std::span<const core::Trajectory> demonstrations, int horizon);

/// An oracle: a one-step filter that uses the plant. It tries the policy's control on a copy of the
/// plant. If the result is outside guided recovery's support (l < 0), it changes the control by the
/// least amount that restores l = 0. The change is along the gradient of l, mapped by the true
/// Jacobian of the state with respect to the control (finite differences on the copy). Halts
/// (kOutsideSupport) if the changed control still leads to l < -Levels::slack(), and after
/// `horizon` controls. Borrows all arguments.
[[nodiscard]] std::unique_ptr<control::Controller> MakeTrueJacobianFilter(
    const safety::TaskModel& task, const core::Policy& policy, const core::SimulatedPlant& plant,
    int horizon);

}  // namespace dfr::study
