#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "dfr/control/controller.h"
#include "dfr/core/plant.h"
#include "dfr/core/trajectory.h"

namespace dfr::control {

/// Options for Rollout().
struct RolloutOptions {
  std::uint64_t plant_seed = 0;       ///< Seed of the start state: core::Plant::Reset().
  std::uint64_t controller_seed = 0;  ///< Seed of the controller: Controller::Reset().
  /// Halts after this many applied controls, of any kind, with HaltCause::kControlLimit.
  int max_controls = 1'000'000;
};

/// Outcome and counts of a rollout.
struct RolloutResult {
  core::Outcome outcome = core::Outcome::kHalted;
  HaltCause halt_cause = HaltCause::kNone;  ///< Not kNone if and only if outcome is kHalted.

  int policy_steps = 0;  ///< Controls of mode kPolicy.
  int probes = 0;
  int recovery_steps = 0;  ///< Controls of mode kRecovery, one per iteration of a recovery.
  int changed_steps = 0;   ///< Controls of mode kPolicy that differ from the policy's.
  int recoveries = 0;      ///< Number of recoveries begun.
  double change = 0.0;     ///< Sum of the measured Step::change of changed controls.
  int sized_changes = 0;   ///< Number of summands in `change`.
  /// Source of the last applied control, which caused a collision if there was one.
  Mode last_mode = Mode::kHalt;
  /// Last result of Next(). At a halt, g and threshold show the distance from the boundary.
  Step last_step;

  /// CPU time of this thread: in the plant (Apply, Observe, completed, collided), and in Next().
  double plant_seconds = 0.0;
  double decision_seconds = 0.0;

  /// Number of controls of recoveries, including probes.
  [[nodiscard]] int recovery_controls() const noexcept { return probes + recovery_steps; }
  /// Number of controls that differ from the learned policy's.
  [[nodiscard]] int changed_controls() const noexcept {
    return changed_steps + recovery_controls();
  }
  /// Number of all applied controls.
  [[nodiscard]] int controls() const noexcept { return policy_steps + recovery_controls(); }
  [[nodiscard]] double seconds() const noexcept { return plant_seconds + decision_seconds; }
};

/// One control that the plant received, and its effect. `status` shows whether the plant applied
/// it. The spans are valid only during the call.
struct RolloutEvent {
  std::span<const double> x;       ///< State before the control.
  std::span<const double> u;       ///< The control.
  std::span<const double> next_x;  ///< State after the control.
  Step step;
  core::PlantStatus status = core::PlantStatus::kOk;
  bool collided = false;
  bool completed = false;
};

/// Observes a rollout, for videos, logs and convergence curves. RolloutResult does not
/// count the time that the observer takes.
class RolloutObserver {
 public:
  virtual ~RolloutObserver() = default;
  /// Receives the start state before the first control.
  virtual void OnStart(std::span<const double> /*x*/) {}
  virtual void OnControl(const RolloutEvent& event) = 0;
  virtual void OnEnd(const RolloutResult& /*result*/) {}
};

/// Buffers for consecutive rollouts.
struct RolloutWorkspace {
  std::vector<double> x;
  std::vector<double> next_x;
  std::vector<double> u;
};

/// Resets plant and controller and runs the controller on the plant until the episode is completed,
/// halted or collided (Sec. V-A). Evaluates collided() and completed() in the start state and after
/// every control, including probes, recovery controls and controls that the plant failed to apply,
/// because the plant may have moved. A collision takes precedence over a failure of the plant, and
/// a failure over completion. Calls the plant's Halt() at the end, even if the observer throws, and
/// then OnEnd(). Does not call Halt() if Reset() throws.
///
/// Never allocates after Reset() of the plant if a `workspace` of the right size is given.
/// @throws std::invalid_argument if the sizes of plant and controller differ or max_controls < 1.
/// Forwards exceptions of the plant's Reset() and of the observer.
RolloutResult Rollout(core::Plant& plant, Controller& controller, const RolloutOptions& options,
                      RolloutObserver* observer = nullptr, RolloutWorkspace* workspace = nullptr);

}  // namespace dfr::control
