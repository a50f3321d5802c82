#pragma once

#include <cstdint>
#include <limits>
#include <span>

namespace dfr::control {

/// Who chose a control.
enum class Mode {
  kPolicy,    ///< The learned policy; consumes a time step.
  kProbe,     ///< A recovery's small control that is applied to see what it does.
  kRecovery,  ///< A recovery's control that is meant to help.
  kHalt,      ///< Nobody: the control is zero, and stays so until Reset().
};

/// Why a controller halts. Name() gives the word used in reports and files.
enum class HaltCause {
  kNone,            ///< It has not halted.
  kNotReset,        ///< Next() before the first Reset().
  kTimeUp,          ///< t = T.
  kStateInvalid,    ///< A state of the wrong size or with a non-finite entry.
  kBadQuaternion,   ///< A quaternion in a state has another length than 1.
  kControlInvalid,  ///< A policy or a recovery gave a non-finite control.
  kSupportInvalid,  ///< g is not finite at a finite state.
  kOutsideSupport,  ///< g <= 0: no control is small enough to be safe.
  kEarlyStopping,   ///< 0 < g <= lambda |u|, and the strategy is to stop there.
  kIterationLimit,  ///< A recovery has used up its iterations.
  kNoDirection,     ///< A recovery found no direction to go.
  kNoProgress,      ///< A recovery no longer gains anything: it holds at the best it found.
  kViolated,        ///< An assumption of a certificate was seen not to hold.
  kControlLimit,    ///< The rollout's limit on applied controls.
  kPlantRefused,    ///< core::PlantStatus::kRefused
  kPlantFault,      ///< core::PlantStatus::kFault
  kStepSkipped,     ///< A call was lost or doubled: what was applied last is not known.
  kStopRequested,   ///< A caller outside asked for it.
};
inline constexpr int kNumHaltCauses = static_cast<int>(HaltCause::kStopRequested) + 1;

[[nodiscard]] const char* Name(Mode mode) noexcept;
[[nodiscard]] const char* Name(HaltCause cause) noexcept;

/// What Controller::Next() decided, and on what grounds.
struct Step {
  Mode mode = Mode::kHalt;
  HaltCause cause = HaltCause::kNone;  ///< Not kNone exactly where mode is kHalt.
  int t = 0;                           ///< The time step whose support and policy were used.
  int iteration = 0;                   ///< In the recovery under way, from 0; 0 where none is.
  /// g_t(x), or NaN where the controller had no need to look.
  double g = std::numeric_limits<double>::quiet_NaN();
  /// The learned control is applied unchanged where g > threshold; NaN where there is no such gate.
  double threshold = std::numeric_limits<double>::quiet_NaN();
  /// l_t(x), the log form of g_t(x), and that of the threshold, where the controller works with l.
  double log_g = std::numeric_limits<double>::quiet_NaN();
  double log_threshold = std::numeric_limits<double>::quiet_NaN();
  /// l_{t+1} that the learned control is predicted to reach, where the controller predicted it.
  double log_learned = std::numeric_limits<double>::quiet_NaN();
  /// Mode kPolicy: the learned control was changed or replaced so as to stay inside the support.
  bool filtered = false;
  /// Distance between this control and the learned one, where they differ: a Euclidean norm in
  /// units of an ordinary demonstrated control. NaN where the controller does not measure it.
  double change = std::numeric_limits<double>::quiet_NaN();
  /// Under the assumptions of the controller's certificate, the next state is inside the support.
  bool certified = false;
};

/// `step` as one that halts.
[[nodiscard]] constexpr Step Halted(Step step, HaltCause cause) noexcept {
  step.mode = Mode::kHalt;
  step.cause = cause;
  return step;
}

/// What drives a plant: observation in, command out. The loop around it belongs to the caller
/// (Rollout(), or a robot's node):
///
///   controller.Reset(seed);
///   while (true) {
///     observe x; step = controller.Next(x, u); if (step.mode == Mode::kHalt) break;
///     apply u, wait until at rest; if that failed: controller.Stop(cause), break;
///   }
///
/// A further call of Next() therefore means that the previous control was applied in full, and that
/// x is the state it led to: a controller sees every applied control with its outcome. It keeps the
/// time step itself; recovery controls do not consume one, and a controller may re-align it.
///
/// Whatever the strategy, this class stops at every doubt: a wrong size, a non-finite entry of the
/// state or of the chosen control. Once halted it stays halted, with the cause that came first,
/// until Reset(), and u is zero whenever it is.
///
/// Next(), Reset() and Stop() neither allocate, lock nor throw. One object belongs to one thread.
class Controller {
 public:
  virtual ~Controller() = default;

  /// Entries of a state x.
  [[nodiscard]] virtual int state_dim() const noexcept = 0;
  /// Entries of a control u.
  [[nodiscard]] virtual int control_dim() const noexcept = 0;

  /// Starts an episode: t = 0, and all that is random follows from `seed`.
  void Reset(std::uint64_t seed) noexcept;

  /// Writes the control to apply in state `x` (state_dim() entries) to `u` (control_dim()).
  [[nodiscard]] Step Next(std::span<const double> x, std::span<double> u) noexcept;

  /// Halts from outside: the plant failed, or an operator asked. Without effect once halted.
  void Stop(HaltCause cause) noexcept;

  /// kNone while the controller is running.
  [[nodiscard]] HaltCause halt_cause() const noexcept { return cause_; }

 private:
  virtual void DoReset(std::uint64_t seed) noexcept = 0;
  /// Next() for a running controller; `x` has state_dim() finite entries, `u` control_dim(). To
  /// halt, return mode kHalt with a cause; whatever is in `u` then is discarded.
  [[nodiscard]] virtual Step DoNext(std::span<const double> x, std::span<double> u) noexcept = 0;

  HaltCause cause_ = HaltCause::kNotReset;
  Step last_;
};

}  // namespace dfr::control
