#include "dfr/safety/guard.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "dfr/control/certified/certified_controller.h"
#include "dfr/control/guided/guided_controller.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/core/policy.h"
#include "dfr/safety/constants.h"

namespace dfr::safety {
namespace {

using control::HaltCause;
using control::Mode;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// A policy that returns an action computed elsewhere.
class ExternalPolicy final : public core::Policy {
 public:
  ExternalPolicy(int state_dim, int action_dim)
      : state_dim_(state_dim), action_(static_cast<std::size_t>(action_dim), 0.0) {}

  /// The action that Control() returns.
  [[nodiscard]] std::span<double> action() noexcept { return action_; }

  [[nodiscard]] int state_dim() const noexcept override { return state_dim_; }
  [[nodiscard]] int control_dim() const noexcept override {
    return static_cast<int>(action_.size());
  }
  void Control(int /*t*/, std::span<const double> /*x*/,
               std::span<double> u) const noexcept override {
    std::copy(action_.begin(), action_.end(), u.begin());
  }

 private:
  int state_dim_;
  std::vector<double> action_;
};

bool Within(const std::vector<double>& limits, std::span<const double> action) noexcept {
  for (std::size_t i = 0; i < action.size(); ++i) {
    if (std::abs(action[i]) > limits[i]) return false;
  }
  return true;
}

void Clamp(const std::vector<double>& limits, std::span<double> action) noexcept {
  for (std::size_t i = 0; i < action.size(); ++i) {
    action[i] = std::clamp(action[i], -limits[i], limits[i]);
  }
}

Method MethodOf(Strategy strategy) {
  // The controller of a certified guard is not part of a task model.
  const bool none = strategy == Strategy::kMonitor || strategy == Strategy::kCertified;
  return ParseMethod(none ? Name(control::Recovery::kNone) : Name(strategy));
}

// Writes the policy's values of the entries that a guard must not change.
void KeepUnsteered(const ActionSpace& actions, std::span<const double> policy,
                   std::span<double> action) noexcept {
  const std::vector<ActionEntry>& entries = actions.entries();
  for (std::size_t i = 0; i < std::min(entries.size(), action.size()); ++i) {
    if (!entries[i].steered) action[i] = policy[i];
  }
}

// Returns true if the controller uses only the steered entries, in the units of the model's
// actions().
bool Steers(const GuardModel& model, const control::RecoveryStrategy* strategy) {
  return strategy == nullptr &&
         (model.settings().strategy == Strategy::kCertified ||
          MethodOf(model.settings().strategy).kind != Method::Kind::kSwitching);
}

std::unique_ptr<control::Controller> MakeController(
    const ExternalPolicy& proposal, const GuardModel& model,
    std::unique_ptr<control::RecoveryStrategy> strategy) {
  const GuardSettings& settings = model.settings();
  if (strategy == nullptr && settings.strategy == Strategy::kCertified) {
    const TaskModel& task = model.task();
    return std::make_unique<control::CertifiedController>(
        proposal, task.view(),
        control::CertifiedOptions{
            .horizon = settings.horizon,
            .max_controls = settings.max_actions,
            .control_limit = model.actions().MeasuredLimits(settings.action_limit),
            .correction_limit = model.actions().MeasuredLimits(model.actions().Limits(1.0)),
            .certificate = model.certificate(),
            .demonstrated = settings.demonstrated});
  }
  ControllerOptions options{.horizon = settings.horizon};
  options.guided.max_controls = settings.max_actions;
  options.guided.demonstrated = settings.demonstrated;
  options.guided.control_limit = model.actions().MeasuredLimits(settings.action_limit);
  return strategy != nullptr
             ? model.task().MakeController(std::move(strategy), proposal, options)
             : model.task().MakeController(MethodOf(settings.strategy), proposal, options);
}

}  // namespace

struct Guard::Episode {
  Episode(const GuardModel& model, std::unique_ptr<control::RecoveryStrategy> strategy)
      : monitors(strategy == nullptr && model.settings().strategy == Strategy::kMonitor),
        steers(Steers(model, strategy.get())),
        published(!steers && strategy == nullptr),
        proposal(model.task_layout().state_dim(),
                 steers ? model.actions().steered_dim() : model.action_dim()),
        controller(MakeController(proposal, model, std::move(strategy))),
        tracker(model.task().view().support()),
        features(static_cast<std::size_t>(model.task().features().num_features())),
        proposed(static_cast<std::size_t>(model.action_dim()), 0.0),
        bounded(proposed),
        given(proposed),
        chosen(proposal.action().size(), 0.0) {
    constants.resize(static_cast<std::size_t>(model.num_constants()));
    if (model.context() != nullptr) {
      context.resize(static_cast<std::size_t>(model.context()->num_features()));
    }
    std::size_t entries = 0;
    for (const SensorGroup& group : model.sensor_groups()) {
      for (const SensorGroup::Range& range : group.ranges) {
        entries += static_cast<std::size_t>(range.size);
      }
    }
    last.resize(entries);
    unchanged.resize(model.sensor_groups().size());
    if (model.reduction() != nullptr) workspace.emplace(*model.reduction());
    guided = dynamic_cast<control::GuidedController*>(controller.get());
    if (guided != nullptr) ahead = std::make_unique<control::GuidedController>(*guided);
  }

  bool monitors;   // The guard only monitors.
  bool steers;     // The controller uses the units of ActionSpace.
  bool published;  // The controller chooses all entries of an action, also those of a gripper.
  ExternalPolicy proposal;
  std::unique_ptr<control::Controller> controller;
  control::GuidedController* guided = nullptr;       // The controller, if it can predict.
  std::unique_ptr<control::GuidedController> ahead;  // A copy for predictions.
  control::PhaseTracker tracker;
  std::optional<control::PhaseTracker> certified;  // Phase of the certified action.
  std::vector<double> features;                    // Features of the last state.
  std::vector<double> proposed;
  std::vector<double> bounded;  // `proposed` within the limits.
  std::vector<double> given;    // Result of the last Filter().
  std::vector<double> chosen;   // Control that the controller chose.
  std::optional<reduction::StateReduction::Workspace> workspace;  // Set if states are reduced.
  int next = 0;
  int entry = -1;  // First entry of the invalid quaternion.
  // A picture of the last state resembles no demonstration, or a constant entry differs.
  bool novel = false;
  std::vector<double> constants;
  std::vector<double> context;
  std::vector<double> last;       // Entries of the sensor groups in the last state.
  std::vector<double> unchanged;  // Standstill of each group.
  double moved = 0.0;             // Increase of `unchanged` by the last applied action.
  int frozen = -1;                // First group that stands still for too long.

  // Returns the task's state for `state`, and true if `state` is valid.
  std::pair<std::span<const double>, bool> TaskState(const GuardModel& model,
                                                     std::span<const double> state) noexcept {
    const bool usable =
        static_cast<int>(state.size()) == model.state_dim() && core::AllFinite(state);
    const bool reduced = !workspace || model.reduction()->Apply(state, *workspace);
    const std::span<const double> task_state = workspace ? workspace->state() : state;
    novel = workspace && workspace->novelty() > 1.0;
    const bool valid = usable && reduced && model.FindImmeasurableAngle(task_state) < 0;
    novel = novel || (valid && model.FindChangedConstant(task_state, constants) >= 0);
    return {task_state, valid};
  }

  // Returns the first sensor group that stands still for too long with `state` as the next state;
  // -1 if there is none. If `remember` is true, updates `last` and `unchanged` with this state.
  int FindFrozen(const GuardModel& model, std::span<const double> state, bool remember) noexcept {
    int found = -1;
    auto before = last.begin();
    for (std::size_t k = 0; k < unchanged.size(); ++k) {
      const SensorGroup& group = model.sensor_groups()[k];
      bool same = next > 0;
      for (const SensorGroup::Range& range : group.ranges) {
        const auto now = state.subspan(static_cast<std::size_t>(range.first),
                                       static_cast<std::size_t>(range.size));
        same = same && std::equal(now.begin(), now.end(), before);
        if (remember && !same) std::copy(now.begin(), now.end(), before);
        before += range.size;
      }
      const double steps = same ? unchanged[k] + moved : 0.0;
      if (remember) unchanged[k] = steps;
      if (found < 0 && steps > group.limit()) found = static_cast<int>(k);
    }
    return found;
  }
};

const char* Name(Source source) noexcept {
  switch (source) {
    case Source::kPolicy:
      return "policy";
    case Source::kPolicyChanged:
      return "policy-changed";
    case Source::kDemonstrations:
      return "demonstrations";
    case Source::kProbe:
      return "probe";
    case Source::kRecovery:
      return "recovery";
    case Source::kHalt:
      break;
  }
  return "halt";
}

const char* Verdict::reason() const noexcept {
  switch (mode) {
    case Mode::kPolicy:
      if (changed) return "changed";
      return g >= 0.0 ? "inside" : "outside";
    case Mode::kProbe:
    case Mode::kRecovery:
      return Name(source);
    case Mode::kHalt:
      break;
  }
  return Name(cause);
}

Guard::Guard(std::shared_ptr<const GuardModel> model,
             std::unique_ptr<control::RecoveryStrategy> strategy)
    : model_(std::move(model)), episode_(std::make_unique<Episode>(*model_, std::move(strategy))) {}

Guard Guard::Load(const std::filesystem::path& path) { return Guard(GuardModel::Load(path)); }

Guard::Guard(Guard&&) noexcept = default;
Guard& Guard::operator=(Guard&&) noexcept = default;
Guard::~Guard() = default;

void Guard::Reset(std::uint64_t seed) noexcept {
  episode_->controller->Reset(seed);
  episode_->tracker.Reset();
  episode_->certified.reset();
  episode_->next = 0;
  episode_->entry = -1;
  episode_->frozen = -1;
}

int Guard::next_step() const noexcept { return episode_->next; }

void Guard::Stop(HaltCause cause) noexcept { episode_->controller->Stop(cause); }

Verdict Guard::Filter(int t, std::span<const double> whole, std::span<const double> action,
                      std::span<double> safe) noexcept {
  Episode& episode = *episode_;
  control::Controller& controller = *episode.controller;
  const auto [state, state_usable] = episode.TaskState(*model_, whole);
  // A halted guard keeps the group that halted it.
  if (controller.halt_cause() == HaltCause::kNone) {
    episode.frozen = state_usable ? episode.FindFrozen(*model_, whole, /*remember=*/true) : -1;
  }
  const bool useless = episode.novel || episode.frozen >= 0;
  const core::StateMap& map = model_->task().features().selection().map();
  const int off = state_usable ? map.FindInvalid(state) : -1;
  const bool action_usable = action.size() == episode.proposed.size() && core::AllFinite(action);
  if (action_usable) std::copy(action.begin(), action.end(), episode.proposed.begin());
  if (t != episode.next) {
    controller.Stop(HaltCause::kStepSkipped);
  } else if (!state_usable || (useless && !episode.monitors)) {
    controller.Stop(HaltCause::kStateInvalid);
  } else if (off >= 0) {
    controller.Stop(HaltCause::kBadQuaternion);
    if (controller.halt_cause() == HaltCause::kBadQuaternion && episode.entry < 0)
      episode.entry = off;
  } else if (!action_usable) {
    controller.Stop(HaltCause::kControlInvalid);
  } else if (!episode.steers && episode.next >= model_->settings().max_actions) {
    // Controllers that steer count their actions themselves.
    controller.Stop(HaltCause::kIterationLimit);
  } else {
    ++episode.next;
    episode.bounded = episode.proposed;
    Clamp(model_->settings().action_limit, episode.bounded);
    if (episode.steers) {
      model_->actions().Measure(episode.bounded, episode.proposal.action());
      if (model_->context() != nullptr) {
        model_->context()->Apply(state, episode.context);
        controller.SetContext(episode.context);
      }
    } else {
      std::copy(episode.bounded.begin(), episode.bounded.end(), episode.proposal.action().begin());
    }
  }
  const bool room = safe.size() == episode.proposed.size();
  if (!room) controller.Stop(HaltCause::kControlInvalid);
  const control::Step step = controller.Next(state, episode.chosen);
  if (step.mode == Mode::kHalt) {
    std::fill(safe.begin(), safe.end(), 0.0);
  } else if (step.mode == Mode::kPolicy && !step.filtered) {
    // The action stays unchanged bit for bit, also for a monitor.
    std::copy(episode.bounded.begin(), episode.bounded.end(), safe.begin());
  } else if (episode.steers) {
    std::copy(episode.bounded.begin(), episode.bounded.end(), safe.begin());
    model_->actions().Restore(episode.chosen, safe);
  } else {
    std::copy(episode.chosen.begin(), episode.chosen.end(), safe.begin());
    if (episode.published) KeepUnsteered(model_->actions(), episode.bounded, safe);
  }
  // Enforces the limits for every source of the action. The caller's recovery has no limits, and
  // unit conversions round.
  if (room) {
    Clamp(model_->settings().action_limit, safe);
    std::copy(safe.begin(), safe.end(), episode.given.begin());
    episode.moved = model_->actions().StepOf(episode.given);
  }

  Verdict verdict{.mode = step.mode,
                  .cause = step.cause,
                  .certified = step.certified,
                  .alarm = useless || !state_usable || off >= 0,
                  .step = step.t,
                  .entry = episode.entry,
                  .frozen = episode.frozen,
                  .threshold = step.threshold,
                  .predicted = step.log_learned,
                  .pass_level = step.log_threshold,
                  .observed_error = step.observed_error};
  if (episode.frozen >= 0)
    verdict.unchanged = episode.unchanged[static_cast<std::size_t>(episode.frozen)];
  if (state_usable) {
    // The supports of all time steps have the same features.
    model_->task().features().Apply(state, episode.features);
    verdict.level = episode.tracker.Follow(episode.features);
    verdict.alarm_step = episode.tracker.phase();
    const double least = -model_->settings().alarm_level;
    // A certificate applies near the controller's time step, also to the state after a halt.
    if (step.certified) episode.certified.emplace(episode.tracker).Reset(step.t);
    if (auto& certified = episode.certified) {
      const double level = step.certified ? step.log_g : certified->Enter(episode.features, least);
      if (level > verdict.level) {
        verdict.level = level;
        verdict.alarm_step = std::min(certified->phase(), model_->num_steps() - 1);
      }
    }
    verdict.alarm = verdict.alarm || !(verdict.level >= least);
    if (episode.monitors) verdict.step = verdict.alarm_step;
    // A halted controller returns values from before the halt.
    const bool seen = step.mode != Mode::kHalt && std::isfinite(step.g);
    verdict.g = seen ? step.g : model_->support().Decision(verdict.step, state);
  }
  // `action` may be the same memory as `safe`, so this compares with the proposed action.
  verdict.changed = !action_usable || !std::equal(safe.begin(), safe.end(),
                                                  episode.proposed.begin(), episode.proposed.end());
  verdict.change =
      action_usable && room ? model_->actions().Distance(episode.proposed, safe) : kNaN;
  switch (step.mode) {
    case Mode::kPolicy:
      verdict.source = verdict.changed ? Source::kPolicyChanged : Source::kPolicy;
      break;
    case Mode::kRecovery:
      verdict.source = episode.guided != nullptr || step.demonstrated ? Source::kDemonstrations
                                                                      : Source::kRecovery;
      break;
    case Mode::kProbe:
      verdict.source = Source::kProbe;
      break;
    case Mode::kHalt:
      verdict.source = Source::kHalt;
      break;
  }
  return verdict;
}

void Guard::Applied(std::span<const double> action) noexcept {
  Episode& episode = *episode_;
  if (action.size() != episode.given.size() || !core::AllFinite(action)) {
    return episode.controller->Stop(HaltCause::kControlInvalid);
  }
  if (episode.next == 0) return episode.controller->Stop(HaltCause::kStepSkipped);
  episode.moved = model_->actions().StepOf(action);
  if (episode.monitors) return;
  if (std::equal(action.begin(), action.end(), episode.given.begin())) {
    if (episode.guided != nullptr) episode.guided->AppliedAsChosen();
    return;
  }
  if (episode.guided == nullptr) return episode.controller->Stop(HaltCause::kStepSkipped);
  // A false report, for example in wrong units, would outweigh all other measurements.
  for (std::size_t i = 0; i < action.size(); ++i) {
    const ActionEntry& entry = model_->actions().entries()[i];
    const double most =
        std::max(model_->settings().action_limit[i], fit::kMostOvershoot * entry.largest);
    if (entry.steered && std::abs(action[i]) > most) {
      return episode.controller->Stop(HaltCause::kControlInvalid);
    }
  }
  model_->actions().Measure(action, episode.chosen);
  // The estimate of the response sums products of squares, which must not overflow.
  const double square = core::AsVector(std::span<const double>(episode.chosen)).squaredNorm();
  if (!std::isfinite(square * square)) return episode.controller->Stop(HaltCause::kControlInvalid);
  episode.guided->Applied(episode.chosen);
}

ChunkVerdict Guard::FilterChunk(int t, std::span<const double> whole,
                                std::span<const double> actions) noexcept {
  Episode& episode = *episode_;
  ChunkVerdict verdict;
  const std::size_t width = episode.proposed.size();
  verdict.cause = episode.controller->halt_cause();
  verdict.halted = verdict.cause != HaltCause::kNone;
  if (verdict.halted) return verdict;
  const auto [state, state_usable] = episode.TaskState(*model_, whole);
  if (t != episode.next) {
    verdict.cause = HaltCause::kStepSkipped;
  } else if (!state_usable ||
             (!episode.monitors &&
              (episode.novel || episode.FindFrozen(*model_, whole, /*remember=*/false) >= 0))) {
    verdict.cause = HaltCause::kStateInvalid;
  } else if (model_->task().features().selection().map().FindInvalid(state) >= 0) {
    verdict.cause = HaltCause::kBadQuaternion;
  } else if (actions.empty() || actions.size() % width != 0 || !core::AllFinite(actions)) {
    verdict.cause = HaltCause::kControlInvalid;
  }
  if (verdict.cause != HaltCause::kNone || !(episode.monitors || episode.ahead != nullptr)) {
    return verdict;
  }
  verdict.judged = static_cast<int>(std::min<std::size_t>(actions.size() / width, kLongestChunk));
  if (episode.ahead != nullptr) episode.ahead->Foresee(*episode.guided, state);
  for (int i = 0; i < verdict.judged; ++i) {
    const std::span<const double> action =
        actions.subspan(static_cast<std::size_t>(i) * width, width);
    if (!Within(model_->settings().action_limit, action)) break;
    if (episode.monitors) {
      const GuardSettings& settings = model_->settings();
      if (t + i >= std::min(settings.horizon, settings.max_actions)) break;
    } else {
      model_->actions().Measure(action, episode.chosen);
      if (!episode.ahead->PassesNext(episode.chosen)) break;
    }
    ++verdict.playable;
  }
  return verdict;
}

}  // namespace dfr::safety
