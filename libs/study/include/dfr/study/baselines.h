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

/// What baselines need that learn anew.
struct Teaching {
  /// Fits the program's learner to all state-control pairs, as the learned policy was fitted but
  /// for the seed. Empty: nothing can be learned anew.
  std::function<std::unique_ptr<const core::Policy>(std::span<const core::Trajectory>,
                                                    std::uint64_t seed)>
      learn = {};
  std::uint64_t seed = 0;  ///< What is random in these baselines follows.
  /// Where the supervisor demonstrates; to be cloned. Null: there is no supervisor to be asked.
  std::shared_ptr<const core::SimulatedPlant> plant = nullptr;
  /// Writes what the supervisor would do in the plant's present state at time step t, without its
  /// noise, to `u`. The episode's seed decides a supervisor's habits.
  std::function<void(const core::SimulatedPlant& plant, int t, std::uint64_t episode,
                     std::span<double> u)>
      supervise = {};
  int horizon =
      0;  ///< Controls of an episode that the supervisor is asked in; 0: the task model's.
};

/// Teaching by imitation::FitMlp() on sets like `like`, with `options` but for the seed; the
/// supervisor is left to the caller.
[[nodiscard]] Teaching TeachMlp(const imitation::DemonstrationSet& like,
                                const imitation::FitMlpOptions& options);

/// The mean of five policies, each learned from demonstrations that were drawn with replacement.
/// Immutable; concurrent calls are safe.
class EnsemblePolicy final : public core::Policy {
 public:
  static constexpr int kMembers = 5;
  static constexpr int kMostControls = 32;

  /// @throws std::invalid_argument if nothing can be learned anew, or controls have more than
  ///   kMostControls entries.
  EnsemblePolicy(const Teaching& teaching, std::span<const core::Trajectory> demonstrations);
  [[nodiscard]] int state_dim() const noexcept override { return members_[0]->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return members_[0]->control_dim(); }
  void Control(int t, std::span<const double> x, std::span<double> u) const noexcept override {
    static_cast<void>(Mean(t, x, u));
  }
  /// As Control(); returns the root mean square distance of the members from their mean.
  double Mean(int t, std::span<const double> x, std::span<double> u) const noexcept;
  /// The largest disagreement in a demonstrated state.
  [[nodiscard]] double demonstrated_disagreement() const noexcept { return demonstrated_; }

 private:
  std::vector<std::unique_ptr<const core::Policy>> members_;
  double demonstrated_ = 0.0;
};

/// Applies the ensemble's mean, and halts (HaltCause::kEarlyStopping) where its members disagree
/// more than in any demonstrated state; and after `horizon` controls. As ensembles gate a learner
/// in EnsembleDAgger (Menda et al., IROS 2019), without the supervisor to hand over to.
[[nodiscard]] std::unique_ptr<control::Controller> MakeEnsembleController(
    std::shared_ptr<const EnsemblePolicy> ensemble, int horizon);

/// DART (Laskey et al., CoRL 2017): as many demonstrations as there are, in which normal noise is
/// added to what the supervisor wants, with the covariance of the learned policy's errors on ten
/// episodes of the supervisor. Learned are the supervisor's controls. Demonstrations that do not
/// complete the task within `horizon` controls are discarded.
/// @throws std::invalid_argument if there is no supervisor, or it hardly ever succeeds.
[[nodiscard]] std::unique_ptr<const core::Policy> LearnWithNoise(
    const Teaching& teaching, const core::Policy& learned,
    std::span<const core::Trajectory> demonstrations, int horizon);

/// DAgger (Ross et al., AISTATS 2011) in ten rounds: the policy so far runs, the supervisor is
/// asked in every state that it comes to, and the next policy is learned from all states so far.
/// The rounds share as many episodes as there are demonstrations. The episodes collide as the
/// policy so far does: no other method here asks the supervisor, or collides while it learns.
/// @throws std::invalid_argument if there is no supervisor.
[[nodiscard]] std::unique_ptr<const core::Policy> LearnByAsking(
    const Teaching& teaching, const core::Policy& learned,
    std::span<const core::Trajectory> demonstrations, int horizon);

/// An oracle: a filter of one step that knows the plant. The policy's control is tried on a copy;
/// where guided recovery's support is left after it, l < 0, it is changed along the gradient of l
/// by the true Jacobian of the state by the control, from differences on the copy, by as little as
/// leads back to l = 0. Halts (kOutsideSupport) where the control found leads farther outside than
/// guided recovery allows, and after `horizon` controls. Borrows all.
[[nodiscard]] std::unique_ptr<control::Controller> MakeTrueJacobianFilter(
    const safety::TaskModel& task, const core::Policy& policy, const core::SimulatedPlant& plant,
    int horizon);

}  // namespace dfr::study
