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
  std::uint64_t plant_seed = 0;       ///< Draws the start state: core::Plant::Reset().
  std::uint64_t controller_seed = 0;  ///< The controller's: Controller::Reset().
  /// Halts after this many applied controls, of any kind, with HaltCause::kControlLimit.
  int max_controls = 1'000'000;
};

/// How a rollout went.
struct RolloutResult {
  core::Outcome outcome = core::Outcome::kHalted;
  HaltCause halt_cause = HaltCause::kNone;  ///< Not kNone exactly where outcome is kHalted.

  int policy_steps = 0;  ///< Controls of the learned policy.
  int probes = 0;
  int recovery_steps = 0;  ///< Controls of mode kRecovery, one per iteration of a recovery.
  int changed_steps = 0;   ///< Controls of mode kPolicy that are not the policy's to the bit.
  int recoveries = 0;      ///< How often a recovery began.
  double change = 0.0;     ///< Sum of Step::change over the changed controls that have one.
  int sized_changes = 0;   ///< Number of these controls.
  /// Who chose the last control that was applied: for a collision, who caused it.
  Mode last_mode = Mode::kHalt;
  /// What Next() returned last: where it halted, g and threshold say how near the boundary.
  Step last_step;

  /// CPU time of this thread: in the plant (Apply, Observe, completed, collided), and in Next().
  double plant_seconds = 0.0;
  double decision_seconds = 0.0;

  /// Controls of recoveries, probes included.
  [[nodiscard]] int recovery_controls() const noexcept { return probes + recovery_steps; }
  /// Controls that are not the learned policy's, to the bit.
  [[nodiscard]] int changed_controls() const noexcept {
    return changed_steps + recovery_controls();
  }
  /// All applied controls: what a robot's time is proportional to.
  [[nodiscard]] int controls() const noexcept { return policy_steps + recovery_controls(); }
  [[nodiscard]] double seconds() const noexcept { return plant_seconds + decision_seconds; }
};

/// One applied control and what it led to. The spans are valid during the call only.
struct RolloutEvent {
  std::span<const double> x;       ///< Before.
  std::span<const double> u;       ///< What was given to the plant.
  std::span<const double> next_x;  ///< After.
  Step step;
  core::PlantStatus status = core::PlantStatus::kOk;
  bool collided = false;
  bool completed = false;
};

/// Looks on, for videos, logs and convergence curves. Its time is not counted.
class RolloutObserver {
 public:
  virtual ~RolloutObserver() = default;
  /// The start state, before the first control.
  virtual void OnStart(std::span<const double> /*x*/) {}
  virtual void OnControl(const RolloutEvent& event) = 0;
  virtual void OnEnd(const RolloutResult& /*result*/) {}
};

/// Buffers that rollouts one after another can share.
struct RolloutWorkspace {
  std::vector<double> x;
  std::vector<double> next_x;
  std::vector<double> u;
};

/// Resets plant and controller and drives one with the other until the episode is completed, halted
/// or collided (Sec. V-A). collided(), then completed(), are looked at in the start state and after
/// every applied control, probes and recovery controls included; a control that the plant failed to
/// apply is looked at too, as it may have moved. However it ends, the plant's Halt() is called
/// last.
///
/// Never allocates after Reset() of the plant if a `workspace` of the right size is given.
/// @throws std::invalid_argument if the sizes of plant and controller differ or max_controls < 1;
///   and what the plant's Reset() and the observer throw.
RolloutResult Rollout(core::Plant& plant, Controller& controller, const RolloutOptions& options,
                      RolloutObserver* observer = nullptr, RolloutWorkspace* workspace = nullptr);

}  // namespace dfr::control
