#include "dfr/study/fitted_task.h"

#include <algorithm>
#include <utility>

#include "dfr/control/guided/guided_controller.h"
#include "dfr/core/contract.h"
#include "dfr/core/matrix.h"

namespace dfr::study {
namespace {

// A policy in the units of a guard's actions. It stores its last control and therefore belongs to
// one thread.
class MeasuredPolicy final : public core::Policy {
 public:
  MeasuredPolicy(const core::Policy& policy, const safety::ActionSpace& actions,
                 std::vector<double> limit, const core::FeatureTransform* context)
      : policy_(&policy),
        actions_(&actions),
        limit_(std::move(limit)),
        last_(static_cast<std::size_t>(actions.dim()), 0.0),
        context_(context) {
    if (context != nullptr) values_.resize(static_cast<std::size_t>(context->num_features()));
    DFR_THROW_UNLESS(policy.control_dim() == actions.dim(),
                     "the policy's controls have "
                         << policy.control_dim()
                         << " entries, but those of the demonstrations have " << actions.dim());
  }
  [[nodiscard]] int state_dim() const noexcept override { return policy_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return actions_->steered_dim(); }
  void Control(int t, std::span<const double> x, std::span<double> a) const noexcept override {
    policy_->Control(t, x, last_);
    Clamp(last_);
    actions_->Measure(last_, a);
    if (guided_ == nullptr || context_ == nullptr) return;
    context_->Apply(x, values_);
    guided_->SetContext(values_);
  }
  // Sets the controller that receives the context of each control.
  void Inform(control::GuidedController* guided) { guided_ = guided; }
  void Clamp(std::span<double> u) const noexcept {
    for (std::size_t i = 0; i < u.size(); ++i) u[i] = std::clamp(u[i], -limit_[i], limit_[i]);
  }
  // Returns the last control within the limits.
  [[nodiscard]] std::span<const double> last() const noexcept { return last_; }

 private:
  const core::Policy* policy_;
  const safety::ActionSpace* actions_;
  std::vector<double> limit_;
  mutable std::vector<double> last_;
  const core::FeatureTransform* context_;
  mutable std::vector<double> values_;
  control::GuidedController* guided_ = nullptr;
};

// A controller in recorded units around a controller in the units of a guard's actions.
class Restored final : public control::Controller {
 public:
  Restored(const core::Policy& policy, const safety::GuardModel& guard,
           const std::vector<double>& limit, const FittedTask::Maker& make)
      : policy_(policy, guard.actions(), limit, guard.context()),
        actions_(&guard.actions()),
        controller_(make(policy_, actions_->MeasuredLimits(limit))),
        chosen_(static_cast<std::size_t>(actions_->steered_dim()), 0.0) {
    policy_.Inform(dynamic_cast<control::GuidedController*>(controller_.get()));
  }
  [[nodiscard]] int state_dim() const noexcept override { return policy_.state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return actions_->dim(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override { controller_->Reset(seed); }
  control::Step DoNext(std::span<const double> x, std::span<double> u) noexcept override {
    const control::Step step = controller_->Next(x, chosen_);
    if (step.mode == control::Mode::kHalt) {
      std::ranges::fill(u, 0.0);
      return step;
    }
    std::ranges::copy(policy_.last(), u.begin());
    if (step.mode == control::Mode::kPolicy && !step.filtered) return step;
    actions_->Restore(chosen_, u);
    policy_.Clamp(u);  // The conversion of units may round beyond a limit.
    return step;
  }

  MeasuredPolicy policy_;
  const safety::ActionSpace* actions_;
  std::unique_ptr<control::Controller> controller_;
  std::vector<double> chosen_;
};

}  // namespace

FittedTask::FittedTask(safety::TaskModel model)
    : model_(std::make_shared<const safety::TaskModel>(std::move(model))) {}

FittedTask::FittedTask(std::shared_ptr<const safety::GuardModel> guard)
    : guard_(std::move(guard)), model_(guard_, &guard_->task()) {
  DFR_THROW_UNLESS(guard_->reduction() == nullptr,
                   "a study takes unreduced states only: choose features without pca:");
}

FittedTask FittedTask::Fit(const core::StateLayout& layout,
                           std::span<const core::Trajectory> demonstrations,
                           const std::string& features) {
  return FittedTask(
      safety::GuardModel::Fit(layout, demonstrations, {.features = features, .accept_any = true}));
}

std::vector<core::Trajectory> FittedTask::Measured(
    std::span<const core::Trajectory> demonstrations) const {
  if (guard_ != nullptr) return guard_->actions().Measured(demonstrations);
  return {demonstrations.begin(), demonstrations.end()};
}

control::Response FittedTask::ResponseOf(std::span<const core::Trajectory> demonstrations) const {
  if (guard_ == nullptr) return model_->response();
  return control::Response(control::FeatureTrajectories(model_->features(), demonstrations));
}

double FittedTask::Distance(std::span<const double> u,
                            std::span<const double> other) const noexcept {
  if (guard_ != nullptr) return guard_->actions().Distance(u, other);
  return (core::AsVector(u) - core::AsVector(other)).norm() / model_->response().control_unit();
}

void FittedTask::Enlarge(std::span<double> direction) const noexcept {
  const double size = model_->response().largest_control() * model_->response().control_unit();
  for (std::size_t i = 0; i < direction.size(); ++i) {
    if (guard_ == nullptr) {
      direction[i] *= size;
    } else {
      const safety::ActionEntry& entry = guard_->actions().entries()[i];
      direction[i] *= entry.steered ? size * entry.unit : entry.largest;
    }
  }
}

std::unique_ptr<control::Controller> FittedTask::MakeController(
    const safety::Method& method, const core::Policy& policy,
    const safety::ControllerOptions& options) const {
  using Kind = safety::Method::Kind;
  safety::ControllerOptions own = options;
  if (own.horizon == 0) own.horizon = horizon();
  if (guard_ != nullptr && !guard_->settings().demonstrated) own.guided.demonstrated = false;
  // Algorithm 1 uses controls in recorded units.
  if (method.kind != Kind::kController && method.kind != Kind::kGuard) {
    return model_->MakeController(method, policy, own);
  }
  return InUnits(policy, options.guided.control_limit,
                 [&](const core::Policy& measured, std::vector<double> limit) {
                   own.guided.control_limit = std::move(limit);
                   return model_->MakeController(method, measured, own);
                 });
}

std::unique_ptr<control::Controller> FittedTask::InUnits(const core::Policy& policy,
                                                         const std::vector<double>& limit,
                                                         const Maker& make) const {
  if (guard_ == nullptr) return make(policy, limit);
  std::vector<double> least = guard_->settings().action_limit;
  DFR_THROW_UNLESS(
      limit.size() == 1 || limit.size() == least.size(),
      "there are " << limit.size() << " limits, but controls have " << least.size() << " entries");
  for (std::size_t i = 0; i < least.size(); ++i) {
    least[i] = std::min(least[i], limit[limit.size() == 1 ? 0 : i]);
  }
  return std::make_unique<Restored>(policy, *guard_, least, make);
}

}  // namespace dfr::study
