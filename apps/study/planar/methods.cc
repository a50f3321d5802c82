#include "apps/study/planar/methods.h"

#include <utility>

#include "dfr/core/contract.h"

namespace dfr::study::planar {
namespace {

std::vector<core::Matrix> States(std::span<const core::Trajectory> demonstrations) {
  std::vector<core::Matrix> states;
  for (const auto& d : demonstrations) states.push_back(d.states);
  return states;
}

core::FeatureSelection All(const Task& task) {
  return core::FeatureSelection::All(task.plant->state_dim());
}

// One common scale for all entries, so that |dz| is |dx| up to that factor.
core::FeatureTransform Isotropic(const Task& task,
                                 std::span<const core::Trajectory> demonstrations) {
  const int n = task.plant->state_dim();
  const core::FeatureTransform whitening = core::FeatureTransform::Whitening(
      All(task), States(demonstrations), {.decorrelate = false, .local = false});
  const double scale = static_cast<double>(n) / whitening.scale().diagonal().cwiseInverse().sum();
  return {All(task), Eigen::VectorXd::Zero(n), scale * core::Matrix::Identity(n, n)};
}

Teaching Teach(const Task& task, std::uint64_t seed) {
  Teaching teaching = SupervisorOf(task);
  teaching.seed = seed;
  teaching.learn = [degree = task.degree](std::span<const core::Trajectory> demonstrations,
                                          std::uint64_t /*seed*/) {
    return std::make_unique<const PolynomialPolicy>(demonstrations, degree);
  };
  return teaching;
}

}  // namespace

safety::TaskOptions TaskOptionsOf(const Task& task, const MethodOptions& options) {
  kernel::TimeVaryingSupportOptions raw;
  raw.svm.gamma = options.raw_gamma > 0.0 ? options.raw_gamma : task.raw_gamma;
  safety::TaskOptions result;
  result.guided.svm.gamma = options.gamma;
  result.guided.svm.tolerance = 1e-6;
  result.guided.window = options.window;
  result.guided.phase_whitening = options.whitening && options.phase_whitening;
  result.guided.hold_ended = options.hold_ended;
  result.whitening.decorrelate = options.whitening;
  result.published = raw;
  result.horizon = task.horizon;
  return result;
}

Teaching SupervisorOf(const Task& task) {
  Teaching teaching;
  teaching.plant = task.plant;
  teaching.supervise = [](const core::SimulatedPlant& plant, int /*t*/, std::uint64_t /*episode*/,
                          std::span<double> u) {
    static_cast<const sim::GalleryPlant&>(plant).Supervise({}, u);
  };
  return teaching;
}

Methods::Methods(const Task& task, std::vector<core::Trajectory> demonstrations,
                 const MethodOptions& options, std::uint64_t seed)
    : task_(task),
      options_(options),
      demonstrations_(std::move(demonstrations)),
      policy_(demonstrations_, task.degree),
      model_(task.plant->layout(), demonstrations_, TaskOptionsOf(task, options)),
      certified_(
          Isotropic(task, demonstrations_), demonstrations_,
          {.svm = {.gamma = options.certified_gamma, .tolerance = 1e-6}, .phase_whitening = false}),
      controllers_(model_, policy_, task.plant->layout(), demonstrations_, Teach(task, seed)),
      gain_(control::EstimateGain(certified_.features(), demonstrations_)),
      direction_error_(
          control::EstimateDirectionError(model_.guided().features(), demonstrations_)) {}

SupportKind SupportOf(std::string_view method) {
  if (method.starts_with("guided") || method == "certified-direction") return SupportKind::kGuided;
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

control::Certificate Methods::certificate(control::CertificateKind kind) const noexcept {
  const double scale = certified_.features().scale()(0, 0);
  // A known K needs no safety factor, but its two factors are rounded apart.
  const double gain =
      task_.gain > 0.0 ? task_.gain * scale * (1.0 + 1e-12) : gain_.value * options_.gain_factor;
  return {.kind = kind,
          .gain = gain,
          .direction_error = direction_error_.value * options_.gain_factor + 1e-9,
          .level = options_.certified_level};
}

std::unique_ptr<control::Controller> Methods::Make(std::string_view method,
                                                   const core::SimulatedPlant& plant) const {
  // Unknown names are refused here, with all that there are.
  static_cast<void>(ParseMethod(method, kPlanarMethods));
  if (!method.starts_with("certified") || !Split(method).support.empty()) {
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
  return std::make_unique<control::GuidedPolicy>(policy_, recovery(SupportOf(method)).model(),
                                                 guided);
}

}  // namespace dfr::study::planar
