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

/// Guided recovery: drives a learned policy inside a support without a dynamics model, as
/// Algorithm 1 does, but learns from every applied control how features change (ResponseEstimate),
/// so that the gradient of the support becomes a direction for controls. In a state with features
/// z, those that controls under way will lead to, in phase tau, with the learned control v_hat and
/// the prediction z'(v) = z + J v + m:
///
///   1. l_{tau+1}(z'(v_hat)) >= hi: v_hat passes (hi is Levels::gate). Where l_tau(z),
///      l_{tau+1}(z) >= hi and v_hat is no larger than demonstrated, it passes without a look at J.
///      With GuidedOptions::least_intervention it passes at Levels::pass already, unless
///      it has passed at the edge of the support for long: the level then rises to hi
///      (guided::kEdgeGrace). There it also passes if the control of 2 and 3 would end outside too,
///      differs from v_hat by half an ordinary control at most (guided::kIdle), and gains no more
///      level than lies between hi and the level at which v_hat passes.
///   2. v <- AscendSupport(v_d, hi), from the control v_d that does what demonstrations did nearby
///      (ResponseEstimate::NominalControl()). If it leads inside, l_{tau+1}(z'(v)) >= 0, v is
///      applied.
///   3. v <- AscendSupport(v_hat, hi). If it leads inside, v is applied; if it does not, the better
///   of
///      both is, where the support is near (reach). Otherwise v_d is: where nothing leads inside,
///      what demonstrations did is known to go on, and what J promises is not. In the last phase 2
///      raises to l = 0 alone, and nothing passes within reach: that support does not move on.
///   4. If that is not predicted to end inside (in a drift: not to end at hi) and J hardly knows a
///      direction of control, a probe along it is applied instead.
///   5. Where the prediction is inside B_{tau+1}, the phase advances by one. Otherwise it advances
///      to the one of the next three whose support fits the prediction best, or waits where it is
///      out of reach and the present support fits better (PhaseTracker).
///   6. HaltRule ends what does not get on.
///
/// A step is a recovery, Mode::kRecovery, where v comes from v_d. Where it comes from v_hat it is
/// Mode::kPolicy, and Step::filtered if v is not v_hat. What passes does so to the bit.
///
/// docs/recovery.md derives all this. Next() neither allocates nor locks.
class GuidedController final : public Controller {
 public:
  /// Borrows the policy and what `task` does.
  /// @throws std::invalid_argument if sizes differ, or an option is out of range.
  GuidedController(const core::Policy& policy, const TaskView& task,
                   const GuidedOptions& options = {});

  [[nodiscard]] int state_dim() const noexcept override { return policy_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return policy_->control_dim(); }

  /// Takes the place of `present`, a policy of the same model and options, in state `x`: what
  /// PassesNext() then says is what `present` would do from there on, which itself stays as it is.
  void Foresee(const GuidedController& present, std::span<const double> x) noexcept;
  /// Whether `control` would pass as it is and is predicted to end inside, at step 1's level; false
  /// once an answer was false. The next call is about the state that this control is predicted to
  /// lead to. From Foresee() on Next() must not be called. Neither allocates nor locks.
  [[nodiscard]] bool PassesNext(std::span<const double> control) noexcept;

  /// Says that `u` (control_dim() finite entries) was applied in place of the control that the last
  /// Next() gave: by a policy that the controller only watches, or by a robot with limits of its
  /// own. Call it before the next Next(), at most once. What is learned and the phase then follow
  /// from `u`; a controller that has halted stays halted. Neither allocates nor locks.
  void Applied(std::span<const double> u) noexcept;

  /// J of the last Next() that needed one, in features per Response::control_unit().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return estimate_.jacobian(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  [[nodiscard]] Step DoNext(std::span<const double> x, std::span<double> u) noexcept override;

  /// Learns from what the last control led to, and tells z_, which the next control will meet.
  void See(std::span<const double> x) noexcept;
  /// Level and phase at z_; with a cause if the episode ends here.
  [[nodiscard]] Step Look() noexcept;
  /// Chooses v_ in place of the learned control `u`, and writes it there if it is another one.
  [[nodiscard]] Step Decide(Step step, std::span<double> u) noexcept;
  [[nodiscard]] bool DeepInside(double level) const noexcept;
  void Advance(double level) noexcept;

  const core::Policy* policy_;
  TaskView task_;
  GuidedOptions options_;
  StepLimits limits_;
  HaltRule halt_rule_;
  ResponseEstimate estimate_;
  StateObserver observer_;
  SafetyFilter filter_;
  PhaseTracker tracker_;
  PhaseTracker chose_in_;  ///< tracker_ as it was when the last control was chosen.

  Progress progress_;
  bool computed_ = false;  ///< estimate_, since DoReset().
  double at_edge_ = 0.0;   ///< Recent steps at the edge that passed, by guided::kEdgeMemory.
  Eigen::VectorXd z_;
  Eigen::VectorXd v_;  ///< The control that is applied, from then on the one applied last.
  Eigen::VectorXd seen_;
  Eigen::VectorXd last_seen_;
  Eigen::VectorXd dz_;
  Eigen::VectorXd learned_;
  Eigen::VectorXd foreseen_;  ///< PassesNext()'s control.
};

}  // namespace dfr::control
