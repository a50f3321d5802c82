#pragma once

#include <cstdint>
#include <span>

#include "dfr/control/certified/certified_options.h"
#include "dfr/control/certified/certifier.h"
#include "dfr/control/controller.h"
#include "dfr/control/guided/halt_rule.h"
#include "dfr/control/guided/support_step.h"
#include "dfr/control/guided/task_view.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/control/response/response_estimate.h"
#include "dfr/core/policy.h"

namespace dfr::control {

/// Certified recovery: applies a control only if it provably ends inside a support B_q(eta) with
/// |q - tau| <= PhaseTracker::kWindow. Let z be the features of the state, tau the phase, v_hat the
/// learned control, and z'(v) = z + J v the prediction.
///
///   1. The phase becomes a q with l_q(z) >= -eta, so it advances only into supports that contain
///      the state. Outside all supports the controller halts with kOutsideSupport.
///   2. v <- AscendSupport(v_hat, hi) towards the support of tau + 1, with Levels::median() of tau
///      + 1 as hi. A higher level would let fewer controls pass. If l_tau(z) and l_{tau+1}(z) are
///      at least hi and v_hat is no larger than demonstrated, v = v_hat.
///   3. If v is not predicted to end inside and J is uncertain in a direction of control, a probe
///      along this direction replaces v.
///   4. Certifier::Admit() changes or shrinks v until it passes. No correction exceeds
///      CertifiedOptions::correction_limit. If almost nothing of v passes, it
///      becomes a recovery that ascends l_tau from v = 0. A shrunk learned control consumes the
///      same fraction of a time step. After kMaxStalls stalls the controller halts (kNoProgress).
///   5. HaltRule ends the episode at its limits. Its patience counts consecutive recoveries and
///      probes. Other controls consume time, even if only a part of them passes.
///
/// A certificate assumes that controls act at once, that nothing else moves the state, and that
/// observed states are exact up to delta. The controller compares the assumption with the outcome
/// of each control and halts with kViolated at the first violation (Step::observed_error).
/// docs/certificates.md has the proof.
///
/// Next() neither allocates nor locks.
class CertifiedController final : public Controller {
 public:
  /// Borrows the policy and everything that `task` borrows.
  /// @throws std::invalid_argument if sizes differ, or an option is out of range.
  CertifiedController(const core::Policy& policy, const TaskView& task,
                      const CertifiedOptions& options);

  [[nodiscard]] int state_dim() const noexcept override { return policy_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return policy_->control_dim(); }

  void SetContext(std::span<const double> context) noexcept override { fit_.SetContext(context); }
  /// J of the last Next(), in features per Response::control_unit().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return fit_.jacobian(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  [[nodiscard]] Step DoNext(std::span<const double> x, std::span<double> u) noexcept override;

  [[nodiscard]] bool DeepInside(double level, double hi) const noexcept;
  [[nodiscard]] Mode Correct(const LocalModel& model, const StepTarget& target) noexcept;
  [[nodiscard]] bool Certify(const LocalModel& model, Step& step) noexcept;

  const core::Policy* policy_;
  TaskView task_;
  int first_step_;
  StepLimits limits_;
  StepLimits corrections_;          ///< Limits of a correction of the present learned control.
  Eigen::VectorXd most_corrected_;  ///< CertifiedOptions::correction_limit.
  double max_exit_level_;
  double probe_size_;
  bool demonstrated_;
  HaltRule halt_rule_;
  ResponseEstimate estimate_;
  LocalFit fit_;  ///< Fit at the state of the last control.
  PhaseTracker tracker_;
  Certifier certifier_;

  Progress progress_;
  Eigen::VectorXd z_;
  Eigen::VectorXd dz_;
  Eigen::VectorXd v_;       ///< The control of this step; after the step, the last applied control.
  Eigen::VectorXd effect_;  ///< J v of the last applied control.
  Eigen::VectorXd learned_;
};

}  // namespace dfr::control
