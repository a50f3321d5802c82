#include "dfr/study/controller_factory.h"

#include <algorithm>
#include <array>
#include <utility>

#include "dfr/control/certified/certificate_constants.h"
#include "dfr/control/certified/certified_controller.h"
#include "dfr/core/contract.h"
#include "dfr/core/text/suggest.h"
#include "dfr/experiment/finite_difference_recovery.h"
#include "dfr/study/online_lwr.h"

namespace dfr::study {
namespace {

constexpr std::string_view kCertified = "certified";
constexpr std::string_view kEnsemble = "ensemble";
constexpr std::string_view kFiniteDifference = "finite-difference";
constexpr std::string_view kTrueJacobian = "true-jacobian";
// Methods that consist of a policy without a controller.
constexpr std::array<std::pair<std::string_view, std::string_view>, 6> kAlone = {
    {{"lwr", "baseline@lwr"},
     {"lwr-cv", "baseline@lwr-cv"},
     {"lwr-online", "baseline@lwr-online"},
     {"knn", "baseline@knn"},
     {"dart", "baseline@dart"},
     {"dagger", "baseline@dagger"}}};

// A controller and the policy that it borrows.
class WithPolicy final : public control::Controller {
 public:
  WithPolicy(std::shared_ptr<const core::Policy> policy,
             std::unique_ptr<control::Controller> controller)
      : policy_(std::move(policy)), controller_(std::move(controller)) {}
  [[nodiscard]] int state_dim() const noexcept override { return controller_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return controller_->control_dim(); }

 private:
  void DoReset(std::uint64_t seed) noexcept override { controller_->Reset(seed); }
  control::Step DoNext(std::span<const double> x, std::span<double> u) noexcept override {
    return controller_->Next(x, u);
  }
  std::shared_ptr<const core::Policy> policy_;
  std::unique_ptr<control::Controller> controller_;
};

// A controller around a policy that learns from the applied controls.
class WithOnlinePolicy final : public control::Controller, public LearnsOnline {
 public:
  WithOnlinePolicy(std::shared_ptr<OnlineLwrPolicy> policy,
                   std::unique_ptr<control::Controller> controller)
      : policy_(std::move(policy)), controller_(std::move(controller)) {}
  [[nodiscard]] int state_dim() const noexcept override { return controller_->state_dim(); }
  [[nodiscard]] int control_dim() const noexcept override { return controller_->control_dim(); }
  void Applied(std::span<const double> u) noexcept override { policy_->Applied(u); }

 private:
  void DoReset(std::uint64_t seed) noexcept override {
    policy_->Reset();
    controller_->Reset(seed);
  }
  control::Step DoNext(std::span<const double> x, std::span<double> u) noexcept override {
    policy_->See(x);
    const control::Step step = controller_->Next(x, u);
    if (step.mode != control::Mode::kHalt) policy_->Applied(u);
    return step;
  }
  std::shared_ptr<OnlineLwrPolicy> policy_;
  std::unique_ptr<control::Controller> controller_;
};

}  // namespace

bool IsOracle(std::string_view method) noexcept {
  const std::string_view controller = Split(method).controller;
  return controller == kTrueJacobian || controller == kFiniteDifference;
}

MethodName Split(std::string_view name) noexcept {
  MethodName parts;
  const std::size_t slash = std::min(name.find('/'), name.size());
  if (slash < name.size()) parts.support = name.substr(slash + 1);
  name = name.substr(0, slash);
  for (const auto& [policy, whole] : kAlone) {
    if (name == policy) name = whole;
  }
  const std::size_t at = std::min(name.find('@'), name.size());
  if (at < name.size()) parts.policy = name.substr(at + 1);
  parts.controller = name.substr(0, at);
  return parts;
}

std::vector<std::string_view> PoliciesFor(std::span<const std::string_view> others) {
  std::vector<std::string_view> names;
  for (const std::string_view policy : kPolicies) {
    const bool alone = std::ranges::count(kOtherMethods, policy) > 0;
    const std::string_view needed = alone ? policy : kTrueJacobian;
    if (policy == "none" || std::ranges::count(others, needed) > 0) names.push_back(policy);
  }
  return names;
}

safety::Method ParseMethod(std::string_view name, std::span<const std::string_view> others) {
  const std::string_view first = name.substr(0, name.find('/'));
  const bool alone =
      std::ranges::any_of(kAlone, [first](auto& pair) { return pair.first == first; });
  if (alone && std::ranges::count(others, first) == 0) {
    throw core::UnknownName("method", name, safety::MethodNames(others));
  }
  const MethodName parts = Split(name);
  const std::vector<std::string_view> policies = PoliciesFor(others);
  DFR_THROW_UNLESS(
      name.find('@') == std::string_view::npos || std::ranges::count(policies, parts.policy) == 1,
      "method '" << name << "': unknown policy '" << parts.policy
                 << "'; valid: " << Join(policies));
  const bool on_support = name.find('/') != std::string_view::npos;
  DFR_THROW_UNLESS(!on_support || std::ranges::count(kSupports, parts.support) == 1,
                   "method '" << name << "': unknown support '" << parts.support
                              << "'; valid: " << Join(kSupports));
  if (on_support && parts.controller == kCertified) {
    return {.name = std::string(name), .kind = safety::Method::Kind::kController};
  }
  safety::Method method = safety::ParseMethod(parts.controller, others);
  const bool steers = method.kind != safety::Method::Kind::kOther || IsOracle(parts.controller);
  DFR_THROW_UNLESS(steers || parts.policy.empty(),
                   "method '" << name << "': '" << parts.controller
                              << "' takes no other policy; write '" << parts.controller
                              << "', or 'controller@" << parts.policy
                              << "' for a controller around that policy");
  DFR_THROW_UNLESS(!on_support || method.kind != safety::Method::Kind::kOther,
                   "method '" << name << "': '" << parts.controller << "' takes no support");
  method.name = name;
  return method;
}

bool IsPolicy(std::string_view method) noexcept {
  const std::string_view controller = Split(method).controller;
  return controller == control::Name(control::Recovery::kNone) || controller == kEnsemble;
}

std::string MethodHelp(std::span<const std::string_view> others) {
  constexpr std::array<std::pair<std::string_view, std::string_view>, 5> kMeanings = {
      {{"lwr",
        "lwr, lwr-cv and knn are regressions on the demonstrations themselves (lwr-cv with a "
        "width by cross-validation), lwr-online is one that adapts to the effects of controls "
        "during an episode"},
       {"ensemble", "ensemble halts when five policies disagree"},
       {"dart", "dart learns from demonstrations with injected noise"},
       {"dagger", "dagger asks the supervisor while it learns"},
       {kTrueJacobian, "finite-difference and true-jacobian are oracles that use the plant"}}};
  std::string meanings;
  for (const auto& [method, meaning] : kMeanings) {
    if (std::ranges::count(others, method) == 0) continue;
    meanings.append(meanings.empty() ? "; " : ", ").append(meaning);
  }
  return safety::MethodNames(others) + meanings +
         ". Append @ and a policy to replace the learned one, as in controller@lwr, or none for a "
         "zero control: " +
         Join(PoliciesFor(others)) +
         ". Then append / and another support, as in dfr@lwr/density: " + Join(kSupports);
}

std::string MarksOf(std::span<const std::string> methods) {
  std::string marks;
  const auto mark = [&](std::string_view what, const auto& applies) {
    std::string names;
    for (const std::string& method : methods) {
      if (applies(Split(method))) names.append(names.empty() ? "" : ", ").append(method);
    }
    if (!names.empty()) marks.append(names).append(what).append("\n");
  };
  mark(": an oracle, which tries controls on a copy of the plant",
       [](const MethodName& name) { return IsOracle(name.controller); });
  mark(": an adversary, which tries controls on a copy of the plant", [](const MethodName& name) {
    return name.policy == "at-constraints" || name.policy == "out-of-support";
  });
  mark(": asks the supervisor while it learns, and may collide meanwhile",
       [](const MethodName& name) { return name.policy == "dagger"; });
  mark(": learned from separate demonstrations, with injected noise",
       [](const MethodName& name) { return name.policy == "dart"; });
  return marks;
}

std::unique_ptr<control::Controller> ControllerFactory::Make(
    std::string_view method, const core::SimulatedPlant* plant,
    const safety::ControllerOptions& options) const {
  const safety::Method parsed = ParseMethod(method);
  const std::string_view name = Split(method).policy;
  std::shared_ptr<const core::Policy> other;
  std::shared_ptr<OnlineLwrPolicy> online;
  if (name == kOnlineLwr) {
    online = std::make_shared<OnlineLwrPolicy>(task_->model().features(),
                                               task_->ResponseOf(demonstrations_), options.guided);
    other = online;
  } else if (!name.empty()) {
    const bool unlearned = name == "lwr" || name == "lwr-cv" || name == "knn" || name == "none";
    DFR_THROW_UNLESS(plant != nullptr || unlearned,
                     "policy '" << name << "' is for simulations only");
    other = policies_.Make(name, plant);
  }
  const core::Policy& policy = other != nullptr ? *other : *learned_;
  const int horizon = options.horizon != 0 ? options.horizon : task_->horizon();
  std::unique_ptr<control::Controller> controller;
  if (parsed.kind == safety::Method::Kind::kOther && Split(method).controller == kEnsemble) {
    return MakeEnsembleController(policies_.Ensemble(), horizon);
  }
  if (!Split(method).support.empty()) {
    controller = OnSupport(Split(method), parsed, policy, options);
  } else if (parsed.kind != safety::Method::Kind::kOther) {
    controller = task_->MakeController(parsed, policy, options);
  } else {
    DFR_THROW_UNLESS(plant != nullptr, "oracles need the driven plant");
    controller = Split(method).controller == kTrueJacobian
                     ? MakeTrueJacobianFilter(task_->model(), policy, *plant, horizon)
                     : task_->model().MakeController(
                           std::make_unique<experiment::FiniteDifferenceRecovery>(
                               *plant, task_->model().support()),
                           policy, {.horizon = horizon, .first_step = options.first_step});
  }
  if (online != nullptr) {
    return std::make_unique<WithOnlinePolicy>(std::move(online), std::move(controller));
  }
  if (other == nullptr) return controller;
  return std::make_unique<WithPolicy>(std::move(other), std::move(controller));
}

std::unique_ptr<control::Controller> ControllerFactory::OnSupport(
    const MethodName& name, const safety::Method& method, const core::Policy& policy,
    const safety::ControllerOptions& options) const {
  const std::shared_ptr<const SupportModel> support = supports_.Get(std::string(name.support), [&] {
    return SupportModel(name.support, *task_, layout_, demonstrations_);
  });
  // The cache keeps the support as long as this factory exists.
  const int horizon = options.horizon != 0 ? options.horizon : task_->horizon();
  const bool guards = method.kind == safety::Method::Kind::kGuard;
  if (!guards && method.kind != safety::Method::Kind::kController) {
    return std::make_unique<control::SwitchingController>(
        policy, support->decision(), support->lambda(),
        control::SwitchingControllerOptions{
            .recovery = method.recovery,
            .horizon = horizon,
            .first_step = options.first_step,
            .dfr = method.published_dfr ? control::DfrOptions{} : options.dfr});
  }
  if (name.controller == kCertified) {
    // The certificate assumes twice this error, as in a guard.
    const double error = control::EstimateDirectionError(support->view().features(),
                                                         task_->Measured(demonstrations_))
                             .value;
    return task_->InUnits(
        policy, control::CertifiedOptions().control_limit,
        [&](const core::Policy& measured, std::vector<double> limit) {
          return std::make_unique<control::CertifiedController>(
              measured, support->view(),
              control::CertifiedOptions{.horizon = horizon,
                                        .first_step = options.first_step,
                                        .control_limit = std::move(limit),
                                        .certificate = {.direction_error = 2.0 * error + 1e-9}});
        });
  }
  control::GuidedOptions guided = control::Without(options.guided, method.without);
  guided.horizon = horizon;
  guided.first_step = options.first_step;
  guided.least_intervention = guards;
  return task_->InUnits(policy, options.guided.control_limit,
                        [&](const core::Policy& measured, std::vector<double> limit) {
                          guided.control_limit = std::move(limit);
                          return std::make_unique<control::GuidedController>(
                              measured, support->view(), guided);
                        });
}

}  // namespace dfr::study
