#pragma once

#include <cstdint>
#include <span>

#include "dfr/control/controller.h"
#include "dfr/control/guided/guided_options.h"
#include "dfr/control/guided/halt_rule.h"
#include "dfr/control/guided/response_estimate.h"
#include "dfr/control/guided/safety_filter.h"
#include "dfr/control/guided/state_observer.h"
#include "dfr/control/guided/support_step.h"
#include "dfr/control/guided/task_view.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/core/policy.h"

namespace dfr::control {

/// Guided recovery: keeps a learned policy inside a support without a dynamics model. Algorithm 1
/// does the same; guided recovery also learns from every applied control how features change
/// (ResponseEstimate). The gradient of the support thereby becomes a direction for controls.
///
/// Let z be the features of the state once pending controls have taken effect, tau the phase, v_hat
/// the learned control, and z'(v) = z + J v + m the prediction.
///
///   1. If l_{tau+1}(z'(v_hat)) >= hi (Levels::gate), v_hat passes. If l_tau(z), l_{tau+1}(z) >= hi
///      and v_hat is no larger than demonstrated, it passes without an evaluation of J. With
///      GuidedOptions::least_intervention it passes from Levels::pass on; after a longer stay at
///      the edge of the support than in demonstrations, this level rises to hi
///      (Levels::edge_stay()). It also passes if the control of steps 2 and 3 would end outside
///      too, differs from v_hat by at most half an ordinary control (guided::kIdle), and gains at
///      most hi minus the level at which v_hat passes.
///   2. v <- AscendSupport(v_d, hi), where v_d has the effect of nearby demonstrations
///      (LocalFit::NominalControl()). If l_{tau+1}(z'(v)) >= 0, v is applied.
///   3. v <- AscendSupport(v_hat, hi). If it leads inside, v is applied. Otherwise the better of
///      both is applied, if its level is at least -max_exit_level. Otherwise v_d is applied: if no
///      control leads inside, demonstrations are more reliable than J. In the last phase step 2
///      ascends to l = 0 only, and no control outside passes, because that support does not move
///      on.
///   4. If this control is not predicted to end inside (under a disturbance: at hi) and J is
///      uncertain in a direction of control, a probe along this direction is applied instead.
///   5. If the prediction is inside B_{tau+1}, the phase advances by one. Otherwise it advances to
///      the one of the next three phases whose support fits the prediction best, or stays if the
///      prediction is beyond the exit level and the present support fits better (PhaseTracker).
///      With GuidedOptions::least_intervention, after half of GuidedOptions::patience controls in a
///      phase, in a state beyond the exit level of its support, the phase becomes the one whose
///      support contains the state most deeply, if there is one: the task goes on from there. This
///      evaluates all supports once, at most guided::kMostRelocations times in an episode.
///   6. HaltRule ends episodes without progress.
///
/// A step is a recovery (Mode::kRecovery) if v comes from v_d. If it comes from v_hat, the mode is
/// Mode::kPolicy, and Step::filtered is set if v differs from v_hat. A control that passes is
/// unchanged to the bit.
///
/// docs/recovery.md derives the method. Next() neither allocates nor locks.
class GuidedController final : public Controller {
 public:
  /// Borrows the policy and everything that `task` borrows.
  /// @throws std::invalid_argument if sizes differ, or an option is out of range.
  GuidedController(const core::Policy& policy, const TaskView& task,
                   const GuidedOptions& options = {});

  [[nodiscard]] int state_dim() const noexcept override { return policy_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return policy_->control_dim(); }

  /// Copies the situation of `present`, a controller of the same model and options, in state `x`.
  /// PassesNext() then predicts the decisions of `present`, which does not change.
  void Foresee(const GuidedController& present, std::span<const double> x) noexcept;
  /// Returns true if `control` would pass unchanged and is predicted to end inside, at the level of
  /// step 1. After the first false, all results are false. The next call starts in the predicted
  /// state. Do not call Next() after Foresee(). Neither allocates nor locks.
  [[nodiscard]] bool PassesNext(std::span<const double> control) noexcept;

  /// Reports that `u` (control_dim() finite entries) was applied instead of the control of the last
  /// Next(): by a policy that the controller only monitors, or by a robot with other limits. Call
  /// it before the next Next(), at most once. The estimate and the phase are then updated with `u`.
  /// A halted controller stays halted. Neither allocates nor locks.
  void Applied(std::span<const double> u) noexcept;

  /// Returns J of the last Next() that computed one, in features per Response::control_unit().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return fit_.jacobian(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  [[nodiscard]] Step DoNext(std::span<const double> x, std::span<double> u) noexcept override;

  /// Updates the estimate with the effect of the last control, and computes z_.
  void See(std::span<const double> x) noexcept;
  /// Computes level and phase at z_, and a cause if the episode ends here.
  [[nodiscard]] Step Look() noexcept;
  /// Chooses v_ from the learned control `u`. Writes it to `u` if it differs.
  [[nodiscard]] Step Decide(Step step, std::span<double> u) noexcept;
  /// Looks up the phase again if the episode is stuck outside the support of the present one.
  void Relocate() noexcept;
  [[nodiscard]] bool DeepInside(double level) const noexcept;
  void Advance(double level) noexcept;

  const core::Policy* policy_;
  TaskView task_;
  GuidedOptions options_;
  StepLimits limits_;
  HaltRule halt_rule_;
  ResponseEstimate estimate_;
  LocalFit fit_;
  StateObserver observer_;
  SafetyFilter filter_;
  PhaseTracker tracker_;
  PhaseTracker chose_in_;  ///< Copy of tracker_ from before the last choice of a control.

  Progress progress_;
  int fitted_ = 0;    ///< Number of the control for which fit_ was made, from 1; 0: none yet.
  EdgeStay at_edge_;  ///< Counts steps whose learned control passed.
  int relocations_ = 0;
  Eigen::VectorXd z_;
  Eigen::VectorXd v_;  ///< The control of this step; after the step, the last applied control.
  Eigen::VectorXd seen_;
  Eigen::VectorXd last_seen_;
  Eigen::VectorXd dz_;
  Eigen::VectorXd learned_;
  Eigen::VectorXd foreseen_;  ///< The control of PassesNext().
};

}  // namespace dfr::control
