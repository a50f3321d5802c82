#pragma once

#include <cstdint>
#include <span>

#include "dfr/control/controller.h"
#include "dfr/control/guided/guided_options.h"
#include "dfr/control/guided/halt_rule.h"
#include "dfr/control/guided/safety_filter.h"
#include "dfr/control/guided/state_observer.h"
#include "dfr/control/guided/support_step.h"
#include "dfr/control/guided/task_view.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/policy.h"

namespace dfr::control {

/// Guided recovery: keeps a learned policy inside a support without a dynamics model, like
/// Algorithm 1. In addition, it learns from every applied control how features change
/// (ResponseEstimate). The estimated Jacobian J turns the gradient of the support into a direction
/// for controls.
///
/// docs/recovery.md derives the method and lists the steps of a decision, in the section "One
/// step". SafetyFilter implements steps 1 to 4, PhaseTracker step 5, HaltRule step 6. Two steps
/// differ with GuidedOptions::least_intervention:
///
///   1. The learned control passes at a predicted level of Levels::pass() or more. In a world at
///      rest, Levels::pass() - Levels::pass_depth() suffices, but not after
///      guided::kDepthCorrections corrections until a control passes. If the state stays at the
///      edge longer than in demonstrations, the required level rises to Levels::gate(). A learned
///      control also passes if it reaches this level in the present phase and a lower level in the
///      next: a slow robot may keep its pace. The phase then stays, but not twice in a row.
///   5. If a phase lasts half of GuidedOptions::patience controls and the state is outside its
///      support by more than the exit level, the task continues from the phase whose support
///      contains the state most deeply, if any. Each search evaluates all supports. An episode has
///      at most guided::kMostRelocations relocations.
///
/// Beyond the exit level a control leads away if the distance to the nearest state of all
/// demonstrations grows by more than guided::kLeadsAway of the change of the state. After
/// guided::kMostAway consecutive controls that lead away, the controller halts (HaltRule). Each
/// step beyond the exit level computes the distance to all demonstrated transitions.
///
/// A step is a recovery (Mode::kRecovery) if its control is derived from the nominal control. If it
/// is derived from the learned control, the mode is Mode::kPolicy, and Step::filtered is set if the
/// two differ. A control that passes is unchanged, bit for bit. Next() neither allocates nor locks.
class GuidedController final : public Controller {
 public:
  /// Borrows the policy and everything that `task` borrows.
  /// @throws std::invalid_argument if sizes differ, or an option is out of range.
  GuidedController(const core::Policy& policy, const TaskView& task,
                   const GuidedOptions& options = {});

  [[nodiscard]] int state_dim() const noexcept override { return policy_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return policy_->control_dim(); }

  /// Copies `present`, a controller with the same model and options that has reached state `x`.
  /// PassesNext() then predicts the decisions of `present` without changing it.
  void Foresee(const GuidedController& present, std::span<const double> x) noexcept;
  /// Returns true if `control` would pass unchanged and is predicted to end inside, at the level of
  /// step 1. The next call starts in the predicted state. After the first false, all results are
  /// false. Do not call Next() after Foresee(). Never allocates or locks.
  [[nodiscard]] bool PassesNext(std::span<const double> control) noexcept;

  /// Reports that `u` (control_dim() finite entries) was applied instead of the control of the last
  /// Next(), for example because the controller only monitors a policy or the robot has other
  /// limits. Call it before the next Next(); the last report counts. The estimate and the phase are
  /// then updated with `u`. A halted controller stays halted. Never allocates or locks.
  void Applied(std::span<const double> u) noexcept;
  /// Retracts all reports of Applied() since the last Next().
  void AppliedAsChosen() noexcept;

  void SetContext(std::span<const double> context) noexcept override { fit_.SetContext(context); }
  /// Returns J of the last Next() that computed one, in features per Response::control_unit().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return fit_.jacobian(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  [[nodiscard]] Step DoNext(std::span<const double> x, std::span<double> u) noexcept override;

  /// Updates the estimate with the effect of the last control, and computes z_.
  void See(std::span<const double> x) noexcept;
  /// Computes level and phase at z_, and a cause if the episode ends here.
  [[nodiscard]] Step Look() noexcept;
  /// Chooses v_ from the learned control `u`. Writes v_ to `u` if the two differ.
  [[nodiscard]] Step Decide(Step step, std::span<double> u) noexcept;
  /// Returns true if the last control led away, from a state to one at `level`, both beyond the
  /// exit level.
  [[nodiscard]] bool LeadsAway(double level) noexcept;
  /// Looks up the phase again if the episode is stuck outside the support of the present phase.
  void Relocate() noexcept;
  /// Returns the lowest level of the support at `t` at which a learned control passes.
  [[nodiscard]] double PassLevel(int t) const noexcept;
  /// Returns the lowest level at which a learned control that stays in the phase of `step` passes;
  /// infinity if it may not stay.
  [[nodiscard]] double StayLevel(const Step& step) const noexcept;
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
  PhaseTracker chose_in_;  ///< State of tracker_ at the choice of the last control.
  PhaseTracker moved_to_;  ///< State of tracker_ after that choice.
  Progress progress_;
  EdgeStay at_edge_;     ///< Counts steps at the edge whose learned control passed.
  int corrections_ = 0;  ///< Consecutive controls that did not pass.
  int relocations_ = 0;
  double distance_ = 0.0;  ///< Distance to the nearest demonstrated state; infinity if not needed.
  TransitionStore::Workspace workspace_;  ///< For distance_.
  bool stays_ = false;                    ///< The control of this step stays in the phase.
  double stay_level_ = 0.0;               ///< StayLevel() of this step.
  Eigen::VectorXd z_;
  Eigen::VectorXd v_;  ///< The control of this step; after the step, the last applied control.
  Eigen::VectorXd seen_;
  Eigen::VectorXd last_seen_;
  Eigen::VectorXd dz_;
  Eigen::VectorXd chosen_;  ///< The control that the last Next() chose.
  Eigen::VectorXd learned_;
  Eigen::VectorXd foreseen_;  ///< The control of PassesNext().
};

}  // namespace dfr::control
