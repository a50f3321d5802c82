#include "dfr/control/rollout.h"

#include <time.h>

#include <cmath>
#include <cstddef>

#include "dfr/core/contract.h"

namespace dfr::control {
namespace {

double ThreadSeconds() noexcept {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// Splits elapsed CPU time between accumulators. Each clock read, a system call, ends one interval
// and starts the next.
class Stopwatch {
 public:
  void Start() noexcept { last_ = ThreadSeconds(); }
  void AddTo(double& account) noexcept {
    const double now = ThreadSeconds();
    account += now - last_;
    last_ = now;
  }

 private:
  double last_ = 0.0;
};

void Count(const Step& step, RolloutResult& result) noexcept {
  const Mode mode = step.mode;
  const bool was_recovering =
      result.last_mode == Mode::kProbe || result.last_mode == Mode::kRecovery;
  if (mode == Mode::kPolicy) {
    ++result.policy_steps;
    result.changed_steps += step.filtered ? 1 : 0;
  } else {
    ++(mode == Mode::kProbe ? result.probes : result.recovery_steps);
    if (!was_recovering) ++result.recoveries;
  }
  const bool changed = mode != Mode::kPolicy || step.filtered;
  if (changed && std::isfinite(step.change)) {
    result.change += step.change;
    ++result.sized_changes;
  }
  result.last_mode = mode;
}

// Returns true if the episode ends in the present state.
bool Ended(const RolloutEvent& event, RolloutResult& result) noexcept {
  if (event.collided) {
    result.outcome = core::Outcome::kCollided;
    return true;
  }
  if (event.status != core::PlantStatus::kOk) {
    result.halt_cause = event.status == core::PlantStatus::kRefused ? HaltCause::kPlantRefused
                                                                    : HaltCause::kPlantFault;
    return true;
  }
  if (event.completed) result.outcome = core::Outcome::kCompleted;
  return event.completed;
}

void Drive(core::Plant& plant, Controller& controller, const RolloutOptions& options,
           RolloutObserver* observer, RolloutWorkspace& workspace, RolloutResult& result) {
  plant.Observe(workspace.x);
  if (observer != nullptr) observer->OnStart(workspace.x);
  RolloutEvent event;
  event.collided = plant.collided();
  event.completed = plant.completed();
  if (Ended(event, result)) return;

  Stopwatch stopwatch;
  stopwatch.Start();
  while (true) {
    if (result.controls() >= options.max_controls) controller.Stop(HaltCause::kControlLimit);
    result.last_step = controller.Next(workspace.x, workspace.u);
    stopwatch.AddTo(result.decision_seconds);
    if (result.last_step.mode == Mode::kHalt) {
      result.halt_cause = result.last_step.cause;
      return;
    }
    event.status = plant.Apply(workspace.u);
    plant.Observe(workspace.next_x);
    event.collided = plant.collided();
    event.completed = plant.completed();
    stopwatch.AddTo(result.plant_seconds);

    // A refused control was not applied, so it is not counted.
    if (event.status != core::PlantStatus::kRefused) Count(result.last_step, result);
    if (observer != nullptr) {
      event.x = workspace.x;
      event.u = workspace.u;
      event.next_x = workspace.next_x;
      event.step = result.last_step;
      observer->OnControl(event);
      stopwatch.Start();
    }
    if (Ended(event, result)) {
      if (result.halt_cause != HaltCause::kNone) controller.Stop(result.halt_cause);
      return;
    }
    workspace.x.swap(workspace.next_x);
  }
}

}  // namespace

RolloutResult Rollout(core::Plant& plant, Controller& controller, const RolloutOptions& options,
                      RolloutObserver* observer, RolloutWorkspace* workspace) {
  DFR_THROW_UNLESS(plant.state_dim() == controller.state_dim(),
                   "the plant's state has " << plant.state_dim()
                                            << " entries, but the controller takes "
                                            << controller.state_dim());
  DFR_THROW_UNLESS(plant.control_dim() == controller.control_dim(),
                   "the plant takes " << plant.control_dim()
                                      << " control entries, but the controller gives "
                                      << controller.control_dim());
  DFR_THROW_UNLESS(options.max_controls > 0,
                   "max_controls must be positive, not " << options.max_controls);
  RolloutWorkspace own;
  if (workspace == nullptr) workspace = &own;
  workspace->x.resize(static_cast<std::size_t>(plant.state_dim()));
  workspace->next_x.resize(workspace->x.size());
  workspace->u.resize(static_cast<std::size_t>(plant.control_dim()));

  plant.Reset(options.plant_seed);
  controller.Reset(options.controller_seed);
  RolloutResult result;
  // Calls Halt() in a destructor: the robot must stop even if an observer throws.
  {
    struct HaltAtEnd {
      core::Plant& plant;
      ~HaltAtEnd() { plant.Halt(); }
    } const halt_at_end{plant};
    Drive(plant, controller, options, observer, *workspace, result);
  }
  if (observer != nullptr) observer->OnEnd(result);
  return result;
}

}  // namespace dfr::control
