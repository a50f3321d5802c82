#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <memory>
#include <span>

#include "dfr/control/controller.h"
#include "dfr/control/published/recovery_strategy.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety {

/// Source of an action.
enum class Source {
  kPolicy,          ///< The policy's action, unchanged bit for bit.
  kPolicyChanged,   ///< The policy's action, changed to end inside or clamped to the limit.
  kDemonstrations,  ///< The nominal action of nearby demonstrations, possibly changed.
  kProbe,           ///< A probe of the guard, to measure the effect of an action.
  kRecovery,        ///< A recovery of Algorithm 1, or a certified step that raises the level.
  kHalt,            ///< No source: the action is zero.
};

/// Returns "policy", "policy-changed", "demonstrations", "probe", "recovery" or "halt".
[[nodiscard]] const char* Name(Source source) noexcept;

/// Decision of a guard, and its reasons.
struct Verdict {
  Source source = Source::kHalt;
  /// kPolicy: the policy's action, possibly changed. kProbe, kRecovery: an action of the guard,
  /// because the policy's action would leave the support. kHalt: zero until Reset().
  control::Mode mode = control::Mode::kHalt;
  control::HaltCause cause = control::HaltCause::kNone;  ///< Reason for a halt; otherwise kNone.
  /// True if the guard's action differs from the policy's action.
  bool changed = false;
  /// Euclidean norm of the difference from the policy's action, over steered entries in units in
  /// which an ordinary demonstrated action has length 1 (ActionSpace). NaN if one of the two
  /// actions is invalid.
  double change = 0.0;
  /// Strategy kCertified: under its assumptions, the next state raises no alarm.
  bool certified = false;
  /// True if `level` is below -GuardSettings::alarm_level, or the state is invalid, resembles no
  /// demonstration or is frozen.
  bool alarm = false;
  /// Time step of the alarm: the step near the expected step whose support fits the state best. The
  /// paces of demonstrations and robots differ. kCertified: a step near that of the last certified
  /// action if `level` is higher there, also after a halt.
  int alarm_step = 0;
  int step = 0;  ///< Time step of the strategy, used for g and threshold.
  /// Cause kBadQuaternion: index in GuardModel::task_layout() of the first of the quaternion's
  /// four entries; otherwise -1.
  int entry = -1;
  /// Index in GuardModel::sensor_groups() of the first group that has stood still for longer than
  /// SensorGroup::limit(), and its standstill; -1 and 0 if there is none.
  int frozen = -1;
  double unchanged = 0.0;
  /// g at `step`, positive inside; NaN for an invalid state.
  double g = std::numeric_limits<double>::quiet_NaN();
  /// kDfr and kEarlyStopping: the policy's action passes if g exceeds this value. Strategies that
  /// predict: pass_level as a value of g. NaN for kMonitor.
  double threshold = std::numeric_limits<double>::quiet_NaN();
  /// l, the logarithmic form of g, at alarm_step; NaN for an invalid state.
  double level = std::numeric_limits<double>::quiet_NaN();
  /// kGuard and kController: predicted l of the policy's action at step + 1, and the level at which
  /// the action passes. With kGuard an action below that level passes too if it leads deeper into
  /// the support of `step`. NaN if the guard did not predict l.
  double predicted = std::numeric_limits<double>::quiet_NaN();
  double pass_level = std::numeric_limits<double>::quiet_NaN();
  /// Cause kViolated: the error of the predicted response to the last action, per unit of action,
  /// beyond GuardSettings::direction_error; infinite if the action was zero. Otherwise NaN.
  double observed_error = std::numeric_limits<double>::quiet_NaN();

  /// Returns, for kPolicy, "changed", "inside", or "outside" (passed, although the state is
  /// outside); for kHalt, control::Name(cause); otherwise Name(source).
  [[nodiscard]] const char* reason() const noexcept;
};

/// Decision of a guard on a chunk of actions.
struct ChunkVerdict {
  /// Number of leading actions that are predicted to pass unchanged.
  int playable = 0;
  /// Number of examined actions: all, or Guard::kLongestChunk. 0 for invalid input, a halted guard,
  /// and strategies without predictions: kDfr, kEarlyStopping, kCertified and a recovery of the
  /// caller.
  int judged = 0;
  bool halted = false;  ///< True if the guard had already halted.
  /// Reason for the halt, or the defect of the input.
  control::HaltCause cause = control::HaltCause::kNone;
};

/// A safety filter between a policy and its robot, which keeps states inside the support of the
/// demonstrations:
///
///   guard.Reset(seed);
///   for (int t = 0; !done; ++t) {
///     observe state; ask the policy for an action;
///     const Verdict verdict = guard.Filter(t, state, action, action);
///     apply action, wait until it has taken effect;
///   }
///
/// The guard updates its estimate of the response with every applied action. Each call implies that
/// the last returned action, or the action reported by Applied(), was applied in full and led to
/// `state`. `t` counts the calls, which reveals a lost or repeated call. The guard fails closed: it
/// halts on a state or action of the wrong size or with a non-finite entry, a quaternion whose norm
/// is not 1, a `t` that is not the next one, and a call before Reset(). Unless it only monitors, it
/// also halts on a picture or constant entry that differs from all demonstrations, and on a sensor
/// group that stands still for too long. Actions are then zero until Reset().
///
/// One object belongs to one thread; guards on several threads may share a model. Reset(), Filter()
/// and Applied() neither allocate, lock nor throw.
class Guard {
 public:
  /// @param strategy  if not null, Algorithm 1 with this recovery replaces the strategy of the
  /// model's settings.
  explicit Guard(std::shared_ptr<const GuardModel> model,
                 std::unique_ptr<control::RecoveryStrategy> strategy = nullptr);
  /// Creates a guard from a file. @throws std::runtime_error as GuardModel::Load() does.
  static Guard Load(const std::filesystem::path& path);
  Guard(Guard&&) noexcept;
  Guard& operator=(Guard&&) noexcept;
  ~Guard();

  [[nodiscard]] const GuardModel& model() const noexcept { return *model_; }
  [[nodiscard]] int state_dim() const noexcept { return model_->state_dim(); }
  [[nodiscard]] int action_dim() const noexcept { return model_->action_dim(); }

  /// Starts an episode. `seed` determines all random choices.
  void Reset(std::uint64_t seed = 0) noexcept;

  /// Writes to `safe` (action_dim() entries; may be `action`) the action to apply in `state`
  /// (state_dim() entries) instead of `action` (action_dim() entries). `t` is 0 in the first call
  /// after Reset() and increases by one with each call.
  [[nodiscard]] Verdict Filter(int t, std::span<const double> state, std::span<const double> action,
                               std::span<double> safe) noexcept;

  /// Reports that `action` (action_dim() entries) was applied instead of the result of the last
  /// Filter(), for example by a robot with other limits. If the caller reports the policy's action
  /// after each Filter(), the guard runs in shadow: it judges every action and changes none. Report
  /// before the next Filter(); the last report counts. Has no effect on a halted guard.
  ///
  /// The guard halts if it cannot continue after `action`. kControlInvalid: a wrong number of
  /// entries, a non-finite entry or, unless the guard only monitors, a steered entry beyond both
  /// its limit and five times its largest demonstrated value. kStepSkipped: before the first
  /// Filter(), and for an action other than the result of Filter() under kDfr, kEarlyStopping,
  /// kCertified and a recovery of the caller.
  void Applied(std::span<const double> action) noexcept;

  /// Counts the leading actions of a chunk, concatenated in `actions`, that may be played from
  /// `state` on. An action counts if it is within the limits and predicted to end inside, at the
  /// level at which Filter() passes it. A monitor checks only the limits and the horizon. The first
  /// action is judged as by Filter(), later ones at predicted states. At most kLongestChunk actions
  /// are judged, each in the time of one Filter().
  ///
  /// Does not change the guard, even for invalid input. `t` must equal next_step(). After the call,
  /// play the counted actions, each through Filter() with the observed state, because observations
  /// may differ from predictions. After them, or after the first action that Filter() changes,
  /// query the policy for a new chunk.
  ///
  /// Causes: kStepSkipped for another `t`; kStateInvalid for a state of the wrong size, not finite,
  /// frozen, or unlike demonstrations; kBadQuaternion; kControlInvalid for an empty chunk, a number
  /// of entries that is not a multiple of action_dim(), or a non-finite entry. A halted guard
  /// returns its cause.
  [[nodiscard]] ChunkVerdict FilterChunk(int t, std::span<const double> state,
                                         std::span<const double> actions) noexcept;
  static constexpr int kLongestChunk = 256;

  /// Returns `t` of the next Filter().
  [[nodiscard]] int next_step() const noexcept;

  /// Halts on request of an operator or after a failure of the robot.
  void Stop(control::HaltCause cause = control::HaltCause::kStopRequested) noexcept;

 private:
  struct Episode;
  std::shared_ptr<const GuardModel> model_;
  std::unique_ptr<Episode> episode_;
};

}  // namespace dfr::safety
