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

/// Who chose an action.
enum class Source {
  kPolicy,          ///< The policy: its action, to the bit.
  kPolicyChanged,   ///< The policy: its action, changed so as to end inside, or kept to the limit.
  kDemonstrations,  ///< What demonstrations did nearby, corrected.
  kProbe,           ///< The guard, to find out what an action does.
  kRecovery,        ///< A recovery of Algorithm 1.
  kHalt,            ///< Nobody: zero.
};

/// "policy", "policy-changed", "demonstrations", "probe", "recovery", "halt".
[[nodiscard]] const char* Name(Source source) noexcept;

/// What a guard decided, and on what grounds.
struct Verdict {
  Source source = Source::kHalt;
  /// kPolicy: the policy's action, changed or not; kProbe and kRecovery: the guard's own, because
  /// the policy's would leave the support; kHalt: zero, and so until Reset().
  control::Mode mode = control::Mode::kHalt;
  control::HaltCause cause = control::HaltCause::kNone;  ///< Why it halted; else kNone.
  bool changed = false;                                  ///< The action differs from the policy's.
  /// How far it differs: the Euclidean norm over steered entries in ActionSpace's units, in which
  /// an ordinary demonstrated action has length 1. NaN if one of the two is not an action.
  double change = 0.0;
  /// Strategy kCertified: under its assumptions the next state raises no alarm.
  bool certified = false;
  bool alarm = false;  ///< The state is further outside than demonstrations are: see GuardSettings.
  /// The time step of the demonstrations that the state fits best near the one expected: the
  /// alarm's. Demonstrations and robots go at paces of their own.
  int alarm_step = 0;
  int step = 0;  ///< The time step that the strategy is in: g's and threshold's.
  /// Cause kBadQuaternion: the first of the four entries of the state, by the model's layout();
  /// else -1.
  int entry = -1;
  /// g at that time step, positive inside; NaN if the state is not one.
  double g = std::numeric_limits<double>::quiet_NaN();
  /// The policy's action passes unseen where g is at least this; NaN where there is no such gate.
  double threshold = std::numeric_limits<double>::quiet_NaN();
  /// l, the log form of g, at alarm_step; NaN if the state is not one.
  double level = std::numeric_limits<double>::quiet_NaN();
  /// kGuard and kController: l that the policy's action is predicted to reach at step + 1, and the
  /// one from which on it passes. NaN where there was no need to predict it.
  double predicted = std::numeric_limits<double>::quiet_NaN();
  double pass_level = std::numeric_limits<double>::quiet_NaN();

  /// For kPolicy: "inside", "changed", or "outside" (passed unmodified, as a monitor does).
  /// For kHalt control::Name(cause), otherwise Name(source).
  [[nodiscard]] const char* reason() const noexcept;
};

/// What a guard says of a chunk of actions.
struct ChunkVerdict {
  /// This many of the leading actions pass as they are, by prediction.
  int playable = 0;
  /// So many were looked at: all, or Guard::kLongestChunk. 0 for bad input, a halted guard, and a
  /// strategy that predicts nothing: kDfr, kEarlyStopping, kCertified or a recovery of the
  /// caller's own.
  int judged = 0;
  bool halted = false;  ///< The guard had halted before.
  /// Why it had, or what is wrong with the input.
  control::HaltCause cause = control::HaltCause::kNone;
};

/// Stands between any policy and its robot, and keeps what is applied inside what was demonstrated:
///
///   guard.Reset(seed);
///   for (int t = 0; !done; ++t) {
///     observe state; ask the policy for an action;
///     const Verdict verdict = guard.Filter(t, state, action, action);
///     apply action, wait until it has had its effect;
///   }
///
/// The guard learns from every applied action how states answer. It takes each call to mean that
/// the action it gave last, or the one of Applied(), was applied in full and that `state` is what
/// it led to; `t` counts the calls, so that a lost or doubled one is noticed. It fails closed: a
/// state or action of the wrong size or with a non-finite entry, a quaternion whose length is not
/// 1, a `t` that is not the next one, a call before Reset() and whatever else is doubtful halt it,
/// and then every action is zero until Reset().
///
/// One object belongs to one thread; guards of several share a model. Reset(), Filter() and
/// Applied() neither allocate, lock nor throw.
class Guard {
 public:
  /// With `strategy`, Algorithm 1 with a recovery of the caller's own takes the place of the
  /// strategy in the model's settings.
  explicit Guard(std::shared_ptr<const GuardModel> model,
                 std::unique_ptr<control::RecoveryStrategy> strategy = nullptr);
  /// The guard of a file. @throws std::runtime_error as GuardModel::Load() does.
  static Guard Load(const std::filesystem::path& path);
  Guard(Guard&&) noexcept;
  Guard& operator=(Guard&&) noexcept;
  ~Guard();

  [[nodiscard]] const GuardModel& model() const noexcept { return *model_; }
  [[nodiscard]] int state_dim() const noexcept { return model_->state_dim(); }
  [[nodiscard]] int action_dim() const noexcept { return model_->action_dim(); }

  /// Starts an episode. All that is random follows from `seed`.
  void Reset(std::uint64_t seed = 0) noexcept;

  /// Writes what to apply instead of `action` (action_dim() entries) in `state` (state_dim()
  /// entries) to `safe` (action_dim(); may be `action` itself). `t` is 0 in the first call after
  /// Reset() and goes up by one with each.
  [[nodiscard]] Verdict Filter(int t, std::span<const double> state, std::span<const double> action,
                               std::span<double> safe) noexcept;

  /// Says that `action` (action_dim() entries) was applied in place of what the last Filter() gave.
  /// With the policy's own action after each Filter(), the guard runs in shadow: it judges every
  /// action and changes none. A robot with limits of its own reports what it did. Call it before
  /// the next Filter(), at most once; without effect on a guard that has halted.
  ///
  /// The guard halts if it cannot go on from `action`: kControlInvalid for a wrong number of
  /// entries or one that is not finite, kStepSkipped before the first Filter(), and for an action
  /// other than Filter()'s under kDfr, kEarlyStopping, kCertified and a recovery of the caller's
  /// own.
  void Applied(std::span<const double> action) noexcept;

  /// How many of a chunk's `actions`, one after another in one row, may be played from `state` on.
  /// An action counts if it is within the limits and predicted to end inside, at the level from
  /// which on Filter() passes it; counting stops at the first that is not. A monitor counts what is
  /// within the limits. Predictions use what demonstrations and applied actions showed; the first
  /// action is judged as Filter() would, the later ones at predicted states. No more than
  /// kLongestChunk are judged. It takes as long as that many calls of Filter().
  ///
  /// The guard stays as it is, also after bad input: `t` is the number that the next Filter() will
  /// have. The caller then plays the counted actions, each by a Filter() of its own with the state
  /// that was reached, because a prediction is no observation and Filter() has the last word. After
  /// these, or after the first that Filter() changes, it asks the policy for a new chunk.
  ///
  /// kStepSkipped: another `t`. kStateInvalid: a state of the wrong size or not finite.
  /// kControlInvalid: no action, a number of entries that is no multiple of action_dim(), or one
  /// that is not finite. A halted guard gives its own cause.
  [[nodiscard]] ChunkVerdict FilterChunk(int t, std::span<const double> state,
                                         std::span<const double> actions) noexcept;
  static constexpr int kLongestChunk = 256;

  /// `t` of the next Filter().
  [[nodiscard]] int next_step() const noexcept;

  /// Halts from outside, if an operator asks or the robot failed.
  void Stop(control::HaltCause cause = control::HaltCause::kStopRequested) noexcept;

 private:
  struct Episode;
  std::shared_ptr<const GuardModel> model_;
  std::unique_ptr<Episode> episode_;
};

}  // namespace dfr::safety
