#pragma once

#include <cstdint>
#include <limits>
#include <span>

namespace dfr::control {

/// Source of a control.
enum class Mode {
  kPolicy,    ///< The learned policy; consumes a time step.
  kProbe,     ///< A small control of a recovery, applied to measure its effect.
  kRecovery,  ///< A corrective control of a recovery.
  kHalt,      ///< None: the control is zero, and remains zero until Reset().
};

/// Reason for a halt. Name() returns the word used in reports and files.
enum class HaltCause {
  kNone,            ///< Not halted.
  kNotReset,        ///< Next() was called before the first Reset().
  kTimeUp,          ///< The time step reached the horizon: t = T.
  kStateInvalid,    ///< A state of the wrong size or with a non-finite entry.
  kBadQuaternion,   ///< The norm of a quaternion in a state is not 1.
  kControlInvalid,  ///< A control has a non-finite entry or the wrong size.
  kSupportInvalid,  ///< At a finite state, g is not finite, or the response cannot be estimated.
  kOutsideSupport,  ///< g <= 0: no control is small enough to be safe.
  kEarlyStopping,   ///< 0 < g <= lambda |u|, and the strategy does not recover.
  kIterationLimit,  ///< The controller reached its limit of recovery iterations or of controls.
  kNoDirection,     ///< A recovery found no direction of ascent.
  kNoProgress,      ///< Controls make no progress, or lead away from demonstrations.
  kViolated,        ///< A transition violated an assumption of a certificate.
  kControlLimit,    ///< The rollout reached its limit on applied controls.
  kPlantRefused,    ///< core::PlantStatus::kRefused
  kPlantFault,      ///< core::PlantStatus::kFault
  kStepSkipped,     ///< A call was lost or repeated, so the last applied control is unknown.
  kStopRequested,   ///< The caller requested the halt.
};
inline constexpr int kNumHaltCauses = static_cast<int>(HaltCause::kStopRequested) + 1;

[[nodiscard]] const char* Name(Mode mode) noexcept;
[[nodiscard]] const char* Name(HaltCause cause) noexcept;

/// Decision of Controller::Next(), and its reasons.
struct Step {
  Mode mode = Mode::kHalt;
  HaltCause cause = HaltCause::kNone;  ///< Not kNone if and only if mode is kHalt.
  int t = 0;                           ///< Time step of the support and the policy.
  int iteration = 0;  ///< Iteration of a recovery, or number of controls since the phase advanced.
  /// g_t(x); NaN if the controller did not evaluate it.
  double g = std::numeric_limits<double>::quiet_NaN();
  /// Threshold of the learned control. Algorithm 1 compares g with it. Guided recovery compares
  /// log_learned with log_threshold instead. NaN if the controller has no gate.
  double threshold = std::numeric_limits<double>::quiet_NaN();
  /// l_t(x), the logarithmic form of g_t(x), and the logarithmic form of the threshold. NaN if the
  /// controller does not use l.
  double log_g = std::numeric_limits<double>::quiet_NaN();
  double log_threshold = std::numeric_limits<double>::quiet_NaN();
  /// Predicted l_{t+1} of the learned control. NaN if the controller did not predict it.
  double log_learned = std::numeric_limits<double>::quiet_NaN();
  /// Mode kPolicy: the learned control was changed or replaced to stay inside the support.
  bool filtered = false;
  /// Euclidean distance between this control and the learned one if they differ, in units of an
  /// ordinary demonstrated control. NaN if the controller does not measure it.
  double change = std::numeric_limits<double>::quiet_NaN();
  /// Mode kRecovery of a certified controller: the nominal control of nearby demonstrations,
  /// possibly changed.
  bool demonstrated = false;
  /// Certified: under the assumptions of the controller's certificate, the next state is inside the
  /// support.
  bool certified = false;
  /// Cause kViolated: the observed |dz - J u| / |u| beyond eps, infinite if u = 0; otherwise NaN.
  double observed_error = std::numeric_limits<double>::quiet_NaN();
};

/// Returns `step` changed to a halt with this cause.
[[nodiscard]] constexpr Step Halted(Step step, HaltCause cause) noexcept {
  step.mode = Mode::kHalt;
  step.cause = cause;
  return step;
}

/// Maps observations of a plant to commands. The caller (Rollout(), or a robot's node) owns the
/// loop:
///
///   controller.Reset(seed);
///   while (true) {
///     observe x; step = controller.Next(x, u); if (step.mode == Mode::kHalt) break;
///     apply u, wait until at rest; if that failed: controller.Stop(cause), break;
///   }
///
/// A further call of Next() therefore implies that the previous control was applied in full and led
/// to x: a controller receives every applied control with its outcome. It counts time steps itself.
/// Recovery controls consume no time step. A controller may move the count to match the state.
///
/// Every controller halts on a wrong size and on a non-finite entry of the state or of the chosen
/// control. It then stays halted, with the first cause and u = 0, until Reset().
///
/// Next(), Reset() and Stop() neither allocate, lock nor throw. One object belongs to one thread.
class Controller {
 public:
  virtual ~Controller() = default;

  /// Number of entries of a state x.
  [[nodiscard]] virtual int state_dim() const noexcept = 0;
  /// Number of entries of a control u.
  [[nodiscard]] virtual int control_dim() const noexcept = 0;

  /// Starts an episode: t = 0. `seed` determines all random choices.
  void Reset(std::uint64_t seed) noexcept;

  /// Writes the control to apply in state `x` (state_dim() entries) to `u` (control_dim()).
  [[nodiscard]] Step Next(std::span<const double> x, std::span<double> u) noexcept;

  /// Sets the context of the next control (LocalFit::SetContext()). Controllers that do not use
  /// demonstrated controls ignore it.
  virtual void SetContext(std::span<const double> /*context*/) noexcept {}

  /// Halts because of a plant failure or an operator's request. Has no effect once halted.
  void Stop(HaltCause cause) noexcept;

  /// Returns kNone while the controller runs.
  [[nodiscard]] HaltCause halt_cause() const noexcept { return cause_; }

 private:
  virtual void DoReset(std::uint64_t seed) noexcept = 0;
  /// Implements Next() for a running controller. `x` has state_dim() finite entries, `u` has
  /// control_dim() entries. To halt, return mode kHalt with a cause; `u` is then ignored.
  [[nodiscard]] virtual Step DoNext(std::span<const double> x, std::span<double> u) noexcept = 0;

  HaltCause cause_ = HaltCause::kNotReset;
  Step last_;
};

}  // namespace dfr::control
