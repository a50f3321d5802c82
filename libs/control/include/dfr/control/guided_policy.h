#pragma once

#include <cstdint>
#include <span>
#include <string_view>

#include "dfr/control/certifier.h"
#include "dfr/control/controller.h"
#include "dfr/control/guided_model.h"
#include "dfr/control/halt_rule.h"
#include "dfr/control/jacobian_estimate.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/control/support_step.h"
#include "dfr/core/policy.h"

namespace dfr::control {

/// Options for GuidedPolicy: what the task says, then four constants that are meant for every
/// task, and switches for ablations. Levels are values of l, controls are in units of the
/// demonstrations' root mean square.
struct GuidedOptions {
  int horizon = 100;           ///< T: time steps of the learned policy in an episode, > 0.
  int first_step = 0;          ///< Time step and phase that an episode begins with, in [0, T).
  int max_controls = 1200;     ///< In an episode, of any kind, > 0.
  double control_limit = 1.0;  ///< Each entry of an applied control is within +- this.
  /// Where something else moves the world: the time that controls take, |v| = 1 an ordinary one.
  /// Not with a certificate, which holds only where nothing else does.
  DriftTime drift_time = {};
  Certificate certificate = {};

  /// Gradients of l in one step, >= 0. Fewer decide faster and reach less where the learned control
  /// is far off; 0 changes nothing and leaves the learned control alone.
  int iterations = 6;
  /// Where no control is predicted to end inside, the best one passes down to this multiple of
  /// GuidedModel::slack() outside, at most .8 in all: what no control can mend, an object off to
  /// the side, must not stop the task. More completes more and collides more.
  double reach = 2.0;
  /// HaltRule::patience. More completes little and collides more.
  int patience = 12;
  /// The learned control passes as it is while it is predicted to end no further outside than this,
  /// >= 0. More harms less and saves less; 0 is for policies that are not to be trusted. Not with a
  /// certificate.
  double tolerance = 0.0;
  /// Size of a probe, >= 0: above the noise of observations and what drifts meanwhile, below what a
  /// wrong direction may cost. 0: directions of control that nobody has used stay unknown.
  double probe_size = 0.35;
  /// Not to be tuned. Weight of an applied control as a measurement of J, relative to the
  /// demonstrations' (in JacobianOptions), >= 0. 0: J is the demonstrations' alone.
  double online_weight = 1.0;
  /// Not to be tuned. Whether what demonstrations did nearby is tried before the learned control is
  /// changed. Not with a certificate.
  bool demonstrated = true;
  /// Not to be tuned. Whether recoveries overtake phases.
  bool overtakes = true;
  /// Not to be tuned. Whether features may move by themselves, where demonstrations say so
  /// (GuidedModel::own_motion()). Not with a certificate.
  bool own_motion = true;
  /// Not to be tuned. Whether effects may come late. Not with a certificate.
  bool lag = true;
  /// Not to be tuned. Whether noise in what is seen is smoothed. Not with a certificate.
  bool smoothing = true;
};

/// The parts of guided recovery that can be taken out, for ablations: "filter", "reach",
/// "demonstrated", "overtaking", "probing", "online-jacobian", "own-motion", "lag", and "drift",
/// the drift_time of a task that has one.
[[nodiscard]] std::span<const std::string_view> GuidedPartNames() noexcept;
/// The options with these parts at their neutral values; "filter+time" takes out both.
/// @throws std::invalid_argument naming the part that does not exist, and those that do.
[[nodiscard]] GuidedOptions Without(GuidedOptions options, std::string_view parts);

/// Guided recovery: drives a learned policy inside a support without a dynamics model, as
/// Algorithm 1 does, but learns from every applied control how features change (JacobianEstimate),
/// so that the gradient of the support becomes a direction for controls. In a state with features
/// z, those that controls under way will lead to, in phase tau, with the learned control v_hat and
/// the prediction z'(v) = z + J v + m:
///
///   1. l_{tau+1}(z'(v_hat)) >= hi: v_hat passes (hi is GuidedModel::gate_level). Where l_tau(z),
///      l_{tau+1}(z) >= hi and v_hat is no larger than demonstrated, it passes without a look at J.
///      A tolerance takes the place of hi.
///   2. v <- RaiseLevel(v_d, hi), from the control v_d that does what demonstrations did nearby
///      (JacobianEstimate::Demonstrated()). If it leads inside, l_{tau+1}(z'(v)) >= 0, v is
///      applied.
///   3. v <- RaiseLevel(v_hat, hi). If it leads inside, v is applied; if it does not, the better of
///      both is, where the support is near (reach). Otherwise v_d is: where nothing leads inside,
///      what demonstrations did is known to go on, and what J promises is not. In the last phase 2
///      raises to l = 0 alone, and nothing passes within reach: that support does not move on.
///   4. If that is not predicted to end inside (in a drift: not to end at hi) and J hardly knows a
///      direction of control, a probe along it is applied instead.
///   5. The phase advances if the prediction is inside B_{tau+1} or passes within reach; otherwise
///      a recovery overtakes phases (PhaseTracker).
///   6. HaltRule ends what does not get on.
///
/// A step is a recovery, Mode::kRecovery, where z'(v_hat) is outside B_{tau+1} and v does not come
/// from v_hat. Otherwise it is Step::filtered where v is not v_hat.
///
/// With a certificate there is no v_d in 2 and 3, and hi is GuidedModel::median_level. Every
/// applied control is changed or shrunk until it provably ends inside a B_q with |q - tau| <=
/// PhaseTracker::kWindow. kDirection changes it first, by RaiseLevel() towards the level that it
/// needs, from the demonstrated control if need be. The phase is one whose l_q >= -eta, for time
/// advances only into supports that the state is in. Where next to nothing of a control passes, a
/// recovery climbs l_tau from v = 0. A shrunk learned control consumes its share of a time step.
/// Outside the support nothing is certified: the controller halts, kOutsideSupport. A certificate
/// assumes that controls act at once and alone, and that states are what is seen: own motion, lag
/// and smoothing are left out. After each control the assumption is compared with what happened;
/// kViolated halts on the first contradiction, see violation(). docs/certificates.md has the proof.
///
/// docs/recovery.md derives all this. Next() neither allocates nor locks.
class GuidedPolicy final : public Controller {
 public:
  /// Borrows both.
  /// @throws std::invalid_argument if sizes differ, or an option is out of range.
  GuidedPolicy(const core::Policy& policy, const GuidedModel& model,
               const GuidedOptions& options = {});

  [[nodiscard]] int state_dim() const noexcept override { return policy_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return policy_->control_dim(); }

  [[nodiscard]] const Violation& violation() const noexcept { return certifier_.violation(); }
  /// J of the last Next() that needed one (with a certificate: of the last), in features per
  /// GuidedModel::control_unit().
  [[nodiscard]] const Eigen::MatrixXd& jacobian() const noexcept { return estimate_.jacobian(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override;
  [[nodiscard]] Step DoNext(std::span<const double> x, std::span<double> u) noexcept override;

  /// hi of a phase.
  [[nodiscard]] double Gate(int phase) const noexcept {
    return certifier_.active() ? model_->median_level(phase) : model_->gate_level(phase);
  }
  [[nodiscard]] bool DeepInside(double level) const noexcept;
  /// What a learned control was replaced by.
  struct Choice {
    Mode mode;
    double level;  ///< That v_ is predicted to reach in the next phase; 0 where it passes.
  };
  [[nodiscard]] Choice Choose(const LocalModel& model) noexcept;
  void Advance(const LocalModel& model, double level) noexcept;
  [[nodiscard]] bool Probe(const LocalModel& model, double& level) noexcept;
  /// Changes v_ by the smallest steps that surely help until it provably ends inside `phase`.
  [[nodiscard]] bool Project(const LocalModel& model, int phase) noexcept;
  [[nodiscard]] bool Certify(const LocalModel& model, Step& step) noexcept;

  const core::Policy* policy_;
  const GuidedModel* model_;
  GuidedOptions options_;
  StepLimits limits_;
  HaltRule halt_rule_;
  JacobianEstimate estimate_;
  double reach_;  ///< GuidedOptions::reach as a level.
  PhaseTracker tracker_;
  Certifier certifier_;

  Progress progress_;
  int stalls_ = 0;  ///< Certified controls in a row of which next to nothing passed.
  Eigen::VectorXd z_;
  Eigen::VectorXd v_;  ///< The control that is applied, from then on the one applied last.
  Eigen::VectorXd seen_;
  Eigen::VectorXd last_seen_;
  Eigen::VectorXd effect_;  ///< J v of the control applied last, with a certificate.
  Eigen::VectorXd dz_;
  Eigen::VectorXd learned_;
  Eigen::VectorXd trial_;
  Eigen::VectorXd demonstrated_;
};

}  // namespace dfr::control
