#include "dfr/safety/guard.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "dfr/control/certified/certified_policy.h"
#include "dfr/control/phase_tracker.h"
#include "dfr/core/policy.h"

namespace dfr::safety {
namespace {

using control::HaltCause;
using control::Mode;

bool AllFinite(std::span<const double> values) noexcept {
  return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

// The action of a policy that runs somewhere else, as a policy.
class Proposal final : public core::Policy {
 public:
  Proposal(int state_dim, int action_dim, double limit)
      : state_dim_(state_dim), action_(static_cast<std::size_t>(action_dim), 0.0), limit_(limit) {}

  void Set(std::span<const double> action) noexcept {
    std::transform(action.begin(), action.end(), action_.begin(),
                   [this](double a) { return std::clamp(a, -limit_, limit_); });
  }

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
  double limit_;
};

Method MethodOf(Strategy strategy) {
  switch (strategy) {
    case Strategy::kGuided:
    case Strategy::kSoft:
      return {.name = "guided", .kind = Method::Kind::kGuided};
    case Strategy::kDfr:
      return {.name = "dfr", .recovery = control::Recovery::kDfr};
    case Strategy::kEarlyStopping:
      return {.name = "early-stopping", .recovery = control::Recovery::kEarlyStopping};
    case Strategy::kMonitor:
    case Strategy::kCertified:  // Not a method of a task model.
      break;
  }
  return {.name = "baseline"};
}

std::unique_ptr<control::Controller> MakeController(
    const Proposal& proposal, const GuardModel& model,
    std::unique_ptr<control::RecoveryStrategy> strategy) {
  const GuardSettings& settings = model.settings();
  if (strategy == nullptr && settings.strategy == Strategy::kCertified) {
    const TaskModel& task = model.task();
    return std::make_unique<control::CertifiedPolicy>(
        proposal, task.guided().model(),
        control::CertifiedOptions{
            .horizon = settings.horizon != 0 ? settings.horizon : task.horizon(),
            .max_controls = settings.max_actions,
            .control_limit = settings.action_limit,
            .certificate = model.certificate()});
  }
  ControllerOptions options{.horizon = settings.horizon};
  options.guided.max_controls = settings.max_actions;
  options.guided.control_limit = settings.action_limit;
  if (settings.strategy == Strategy::kSoft) {
    options.guided.tolerance = std::max(0.0, settings.alarm_level);
  }
  return strategy != nullptr
             ? model.task().MakeController(std::move(strategy), proposal, options)
             : model.task().MakeController(MethodOf(settings.strategy), proposal, options);
}

}  // namespace

struct Guard::Loop {
  Loop(const GuardModel& model, std::unique_ptr<control::RecoveryStrategy> strategy)
      : monitors(strategy == nullptr && model.settings().strategy == Strategy::kMonitor),
        proposal(model.state_dim(), model.action_dim(), model.settings().action_limit),
        controller(MakeController(proposal, model, std::move(strategy))),
        tracker(model.support()),
        proposed(static_cast<std::size_t>(model.action_dim()), 0.0) {}

  bool monitors;  // Nothing looks at g but the alarm.
  Proposal proposal;
  std::unique_ptr<control::Controller> controller;
  control::PhaseTracker tracker;
  std::vector<double> proposed;
  int next = 0;
};

const char* Verdict::reason() const noexcept {
  switch (mode) {
    case Mode::kPolicy:
      if (changed) return "changed";
      return g >= 0.0 ? "inside" : "outside";
    case Mode::kProbe:
    case Mode::kRecovery:
      return Name(mode);
    case Mode::kHalt:
      break;
  }
  return Name(cause);
}

Guard::Guard(std::shared_ptr<const GuardModel> model,
             std::unique_ptr<control::RecoveryStrategy> strategy)
    : model_(std::move(model)), loop_(std::make_unique<Loop>(*model_, std::move(strategy))) {}

Guard Guard::Load(const std::filesystem::path& path) { return Guard(GuardModel::Load(path)); }

Guard::Guard(Guard&&) noexcept = default;
Guard& Guard::operator=(Guard&&) noexcept = default;
Guard::~Guard() = default;

void Guard::Reset(std::uint64_t seed) noexcept {
  loop_->controller->Reset(seed);
  loop_->tracker.Reset();
  loop_->next = 0;
}

void Guard::Stop(HaltCause cause) noexcept { loop_->controller->Stop(cause); }

Verdict Guard::Filter(int t, std::span<const double> state, std::span<const double> action,
                      std::span<double> safe) noexcept {
  Loop& loop = *loop_;
  control::Controller& controller = *loop.controller;
  const bool action_usable = action.size() == loop.proposed.size() && AllFinite(action);
  if (action_usable) std::copy(action.begin(), action.end(), loop.proposed.begin());
  if (t != loop.next) {
    controller.Stop(HaltCause::kStepSkipped);
  } else if (static_cast<int>(state.size()) != state_dim() || !AllFinite(state)) {
    controller.Stop(HaltCause::kStateInvalid);
  } else if (!action_usable) {
    controller.Stop(HaltCause::kControlInvalid);
  } else {
    ++loop.next;
    loop.proposal.Set(loop.proposed);
  }
  const control::Step step = controller.Next(state, safe);
  // A recovery of the caller's own knows no limit.
  const double limit = model_->settings().action_limit;
  for (double& entry : safe) entry = std::clamp(entry, -limit, limit);

  Verdict verdict;
  verdict.mode = step.mode;
  verdict.cause = step.cause;
  verdict.step = step.t;
  verdict.threshold = step.threshold;
  verdict.certified = step.certified;
  if (static_cast<int>(state.size()) == state_dim() && AllFinite(state)) {
    double level = loop.tracker.Follow(state);
    // What is certified is a level at the controller's time step, which may be another one.
    if (step.certified) level = std::max(level, step.log_g);
    verdict.alarm = !(level >= -model_->settings().alarm_level);
    verdict.alarm_step = loop.tracker.phase();
    if (loop.monitors) verdict.step = verdict.alarm_step;
    // A halted controller repeats what it saw before it halted.
    const bool seen = step.mode != Mode::kHalt && std::isfinite(step.g);
    verdict.g = seen ? step.g : model_->support().Decision(verdict.step, state);
  }
  // Not against `action`, which may be the memory that has just been written to.
  verdict.changed = !action_usable || !std::equal(safe.begin(), safe.end(), loop.proposed.begin(),
                                                  loop.proposed.end());
  return verdict;
}

}  // namespace dfr::safety
