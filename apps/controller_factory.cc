#include "apps/controller_factory.h"

#include "dfr/control/finite_difference_recovery.h"
#include "dfr/core/contract.h"

namespace dfr::apps {

std::unique_ptr<control::Controller> ControllerFactory::Make(
    std::string_view method, const core::SimulatedPlant* plant,
    const safety::ControllerOptions& options) const {
  const safety::Method parsed = ParseMethod(method);
  if (parsed.kind != safety::Method::Kind::kOther) {
    return task_->MakeController(parsed, *policy_, options);
  }
  if (method == "lwr") return task_->MakeController({.name = "baseline"}, lwr_, options);
  DFR_THROW_UNLESS(plant != nullptr, "the finite-difference oracle needs the plant it drives");
  return task_->MakeController(
      std::make_unique<control::FiniteDifferenceRecovery>(*plant, task_->support()), *policy_,
      options);
}

}  // namespace dfr::apps
