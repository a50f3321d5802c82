#pragma once

#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "dfr/control/certificate.h"
#include "dfr/control/controller.h"
#include "dfr/control/guided_model.h"
#include "dfr/control/jacobian_estimate.h"
#include "dfr/core/matrix.h"
#include "dfr/core/policy.h"
#include "dfr/core/random.h"

namespace dfr::control {

/// The parts of guided recovery, each of which can be switched off to see what it is good for.
struct GuidedParts {
  bool margin_gate = true;  ///< The learned control passes where l is high; off: where J says so.
  bool filter = true;       ///< Changes the learned control as little as J demands.
  bool reentry = true;      ///< Climbs back from outside the support; off: halts there.
  bool online_jacobian = true;  ///< Applied controls are measurements of J.
  bool realignment = true;      ///< The phase follows the state; off: it is the time step.
  bool probing = true;          ///< A control direction that is hardly known is tried out.
  bool trust_region = true;     ///< Recovery steps shrink where J predicted wrongly.
  bool backtracking = true;     ///< Where l falls, climbing takes the step that surely raises it.
  bool slack = true;            ///< Accepts the best that J can reach, slightly outside included.
  bool gentle_outside = true;   ///< Recovers with small controls while outside the support.
  bool hold_best = true;        ///< Gives a recovery up that gains nothing more.
  bool patience = true;      ///< Is content with l >= 0 where margins keep the task from going on.
  bool phase_hold = true;    ///< Gets on within the present phase where the next is out of reach.
  bool phase_search = true;  ///< Looks ever further for a phase where none nearby advances.
};

/// Every part with its name, for command lines and ablation tables.
struct GuidedPartName {
  std::string_view name;
  bool GuidedParts::*part;
};
[[nodiscard]] std::span<const GuidedPartName> GuidedPartNames() noexcept;

/// Options for GuidedPolicy. The defaults are meant for every task: lengths are in whitened feature
/// units, controls in units of the demonstrations' root mean square.
struct GuidedOptions {
  GuidedParts parts = {};
  int horizon = 100;           ///< T: controls of the learned policy in an episode, > 0.
  int first_step = 0;          ///< Time step and phase that an episode begins with, in [0, T).
  int max_controls = 1200;     ///< Of any kind in an episode, > 0.
  double control_limit = 1.0;  ///< Each entry of an applied control is within +- this.
  int phase_window = 3;        ///< Re-alignment looks this many phases to either side.
  double phase_penalty = 0.3;  ///< Per phase moved, as a share of the gate level.
  int climb_iterations = 6;
  double climb_step = 0.3;
  double ample_progress = 0.5;  ///< A filtered control keeps this share of the learned one's effect
                                ///< on the way to hi,
  double least_progress = 0.1;  ///< and this on the way to lo.
  double slack_margin = 0.25;   ///< With slack: within this share of it of the best J can reach.
  double probe_size = 0.35;     ///< Above the noise of observations, unlike g / (500 lambda).
  double probe_above = 5.0;     ///< Probes where the largest eigenvalue of A^-1 is beyond this.
  double outside_share = 0.25;  ///< Of the largest demonstrated control, while outside.
  int max_recovery = 40;        ///< Controls of one recovery.
  int max_stalls = 3;           ///< Of these, with next to no move predicted.
  int max_without_gain = 6;     ///< Controls of one recovery since l was last raised.
  /// Controls without a new phase before margins are given up; after half of them the search for
  /// a phase begins to widen.
  int patience = 12;
  /// A certified control is applied only if at least this share of it passes; less is a stall.
  double least_share = 0.02;
  /// Where something else moves the world: the time that controls take, |v| = 1 an ordinary one.
  /// Not with a certificate, which holds only where nothing else does.
  DriftTime drift_time = {};
  Certificate certificate = {};
};

/// How a certificate's assumption failed, at the first control where it was seen to.
struct Violation {
  int control = -1;       ///< Number of the applied control, from 0; -1: none was seen.
  double observed = 0.0;  ///< |dz| / |u|, or |dz - J u| / |u| ...
  double allowed = 0.0;   ///< ... which was trusted to stay below this.
};

/// Guided recovery: drives a learned policy inside a support without a dynamics model, like
/// Algorithm 1, but learns from every applied control how features answer (JacobianEstimate), so
/// that the gradient of the support in features becomes a direction for controls. In state x, with
/// z its features, tau the phase, u the learned control, and levels lo, hi of GuidedModel at tau +
/// 1:
///
///   1. l_tau(z) and l_{tau+1}(z) >= hi: u is applied.
///   2. Otherwise u is changed as little as raises l_{tau+1}(z + J v) to hi, or at least lo, and
///      applied if it still does a share of what u was to do (`Step::filtered`).
///   3. Otherwise the same with the control of a fallback policy, if there is one.
///   4. Otherwise a recovery control climbs l_tau: J' grad l, where J is hardly known a probe.
///      From outside too: the log form keeps its gradient there.
///
/// Recovery controls consume no time step. Halts with kNoProgress where a recovery gains nothing
/// more, and with kIterationLimit after max_recovery controls of one.
///
/// With a certificate every applied control, of whatever kind, is shrunk until it provably ends
/// inside some B_q with |q - tau| <= phase_window; the phase then is a q whose l_q >= 0, for time
/// advances only into supports that the state is in (the published proof takes g_{t+1} for g_t).
/// A shrunk learned control consumes its share of a time step. Outside the support nothing is
/// certified: the controller halts, kOutsideSupport. After each control the assumption is compared
/// with what happened; kViolated halts on the first contradiction, see violation().
///
/// docs/recovery.md derives all this. Next() neither allocates nor locks.
class GuidedPolicy final : public Controller {
 public:
  /// Borrows all; `fallback` may be null.
  /// @throws std::invalid_argument if sizes differ, or an option is out of range.
  GuidedPolicy(const core::Policy& policy, const GuidedModel& model,
               const GuidedOptions& options = {}, const core::Policy* fallback = nullptr);

  [[nodiscard]] int state_dim() const noexcept override { return policy_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return policy_->control_dim(); }

  [[nodiscard]] const Violation& violation() const noexcept { return violation_; }
  /// J of the last Next() that needed one (with a certificate: of the last), in features per
  /// GuidedModel::control_unit().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return estimate_.jacobian(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  [[nodiscard]] Step DoNext(std::span<const double> x, std::span<double> u) noexcept override;

  void Learn() noexcept;
  [[nodiscard]] bool AssumptionHolds() noexcept;
  [[nodiscard]] bool Align() noexcept;
  double LogAfter(int phase, const Eigen::VectorXd& v, std::span<double> gradient) noexcept;
  void Limit(Eigen::VectorXd& v, double limit) const noexcept;
  /// Raises l_phase(z + J v), which is `l` with its gradient in gradient_, towards `target`.
  double Climb(int phase, Eigen::VectorXd& v, double l, double target, double limit,
               double progress) noexcept;
  [[nodiscard]] bool Pass(const Eigen::VectorXd& wanted, double limit, bool margins) noexcept;
  [[nodiscard]] bool Filter(const Eigen::VectorXd& wanted, double limit, bool margins) noexcept;
  [[nodiscard]] bool Recover(double limit, Mode& mode) noexcept;
  [[nodiscard]] double Certify() noexcept;
  [[nodiscard]] Step Emit(Step step, double share, std::span<double> u) noexcept;

  const core::Policy* policy_;
  const GuidedModel* model_;
  const core::Policy* fallback_;
  GuidedOptions options_;
  JacobianEstimate estimate_;
  core::Random random_{0};

  int phase_ = 0;
  int next_phase_ = 0;  ///< Where an applied control of the learned policy leads.
  double time_ = 0.0;
  int controls_ = 0;
  double log_ = 0.0;  ///< l at phase_ and z_.
  int recovery_controls_ = 0;
  int stalls_ = 0;
  int without_gain_ = 0;
  int without_advance_ = 0;
  int furthest_ = -1;
  double best_log_ = 0.0;
  double trust_ = 1.0;
  Violation violation_;

  // The control that was applied last.
  bool pending_ = false;
  bool pending_recovery_ = false;
  int pending_phase_ = 0;
  double pending_log_ = 0.0;
  double pending_predicted_ = 0.0;

  // What a certificate trusts at z_, for the phases around phase_ from the first on.
  int known_balls_ = 0;
  std::vector<SafeBall> balls_;
  core::Matrix shifts_;  ///< One row each.

  Eigen::VectorXd z_;
  Eigen::VectorXd last_z_;
  Eigen::VectorXd last_v_;
  Eigen::VectorXd last_effect_;  ///< J v as it was predicted.
  Eigen::VectorXd dz_;
  Eigen::VectorXd learned_;
  Eigen::VectorXd v_;
  Eigen::VectorXd reach_;
  Eigen::VectorXd trial_;
  Eigen::VectorXd direction_;
  Eigen::VectorXd effect_;
  Eigen::VectorXd learned_effect_;
  Eigen::VectorXd there_;
  Eigen::VectorXd gradient_;
  Eigen::VectorXd shift_;
};

}  // namespace dfr::control
