#include "apps/planar/methods.h"

#include <utility>

#include "dfr/core/contract.h"

namespace dfr::apps::planar {

Methods::Methods(const Task& task, std::vector<core::Trajectory> demonstrations,
                 const MethodOptions& options)
    : task_(task),
      options_(options),
      demonstrations_(std::move(demonstrations)),
      policy_(demonstrations_, task.degree),
      model_(task.plant->layout(), demonstrations_, TaskOptionsOf(task, options)),
      certified_(FitCertified(task, demonstrations_, options)),
      controllers_(model_, policy_, task.plant->layout(), demonstrations_),
      gain_(control::EstimateGain(certified_.features(), demonstrations_)),
      direction_error_(control::EstimateDirectionError(certified_.features(), demonstrations_)) {}

SupportKind SupportOf(std::string_view method) {
  if (method.starts_with("guided")) return SupportKind::kGuided;
  if (method.starts_with("certified")) return SupportKind::kCertified;
  return SupportKind::kRaw;
}

double Methods::Level(SupportKind kind, int t, std::span<const double> x) const {
  if (kind == SupportKind::kRaw) return raw_support().LogDecision(t, x, {});
  const safety::GuidedRecovery& guided = recovery(kind);
  std::vector<double> z(static_cast<std::size_t>(guided.features().num_features()));
  guided.features().Apply(x, z);
  return guided.support().LogDecision(t, z, {});
}

std::unique_ptr<control::Controller> Methods::Make(std::string_view method,
                                                   const core::SimulatedPlant& plant) const {
  // Unknown names are refused here, with all that there are.
  static_cast<void>(ParseMethod(method, kPlanarMethods));
  if (SupportOf(method) != SupportKind::kCertified || !Split(method).support.empty()) {
    return controllers_.Make(method, &plant, {.guided = options_.guided});
  }
  DFR_THROW_UNLESS(Split(method).policy.empty(),
                   "method '" << method << "': certified modes run around the learned policy only");
  control::GuidedOptions guided = options_.guided;
  guided.horizon = task_.horizon;
  for (const auto kind : {control::CertificateKind::kLipschitz, control::CertificateKind::kRadius,
                          control::CertificateKind::kDirection}) {
    if (method == control::Name(kind)) guided.certificate = certificate(kind);
  }
  return std::make_unique<control::GuidedPolicy>(policy_, certified_.model(), guided);
}

}  // namespace dfr::apps::planar
