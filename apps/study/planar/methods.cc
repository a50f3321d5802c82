#include "apps/study/planar/methods.h"

#include <utility>

#include "dfr/control/certified/certified_controller.h"
#include "dfr/core/contract.h"
#include "dfr/core/numerics/folds.h"

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

// Returns features with one common scale for all entries.
core::FeatureTransform Isotropic(const Task& task,
                                 std::span<const core::Trajectory> demonstrations) {
  const int n = task.plant->state_dim();
  const core::FeatureTransform whitening = core::FeatureTransform::Whitening(
      All(task), States(demonstrations), {.decorrelate = false, .local = false});
  const double scale = static_cast<double>(n) / whitening.scale().diagonal().cwiseInverse().sum();
  return {All(task), Eigen::VectorXd::Zero(n), scale * core::Matrix::Identity(n, n)};
}

// Fits the support for Methods::Begins(), in the deterministic order of safety::TaskModel.
kernel::WhitenedSupport StartSupport(const core::FeatureTransform& features,
                                     std::span<const core::Trajectory> demonstrations) {
  std::vector<core::Matrix> points;
  for (const core::Trajectory& d : core::InDeterministicOrder(demonstrations)) {
    points.push_back(features.Apply(d.states));
  }
  return kernel::WhitenedSupport::Fit(
      points, {.svm = {.gamma = 0.35, .tolerance = 1e-6}, .phase_whitening = false});
}

Expert Teach(const Task& task, std::uint64_t seed) {
  Expert teaching = SupervisorOf(task);
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

Expert SupervisorOf(const Task& task) {
  Expert teaching;
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
      fit_(safety::TaskModel(task.plant->layout(), demonstrations_, TaskOptionsOf(task, options))),
      start_model_(task.plant->layout(), demonstrations_, TaskOptionsOf(task, {})),
      start_features_(Isotropic(task, demonstrations_)),
      start_support_(StartSupport(start_features_, demonstrations_)),
      controllers_(fit_, policy_, task.plant->layout(), demonstrations_, Teach(task, seed)),
      direction_error_(control::EstimateDirectionError(model().features(), demonstrations_)) {}

SupportKind SupportOf(std::string_view method) {
  const MethodName name = Split(method);
  DFR_THROW_UNLESS(name.support.empty(), "method '" << method
                                                    << "': a picture shows the method's own "
                                                       "support; remove '/"
                                                    << name.support << "'");
  const bool guided = name.controller.starts_with("controller") || name.controller == "guard" ||
                      name.controller == "true-jacobian" ||
                      name.controller == "certified-direction";
  return guided ? SupportKind::kGuided : SupportKind::kRaw;
}

double Methods::Level(SupportKind kind, int t, std::span<const double> x) const {
  if (kind == SupportKind::kRaw) return raw_support().LogDecision(t, x, {});
  return model().guided_support().LogDecision(t, x, {});
}

bool Methods::Begins(std::span<const double> x) const {
  std::vector<double> z(static_cast<std::size_t>(start_features_.num_features()));
  start_features_.Apply(x, z);
  return start_model_.published()->Decision(0, x) >= 0.0 &&
         start_model_.guided_support().LogDecision(0, x, {}) >= 0.0 &&
         start_support_.LogDecision(0, z, {}) >= 0.0;
}

control::Certificate Methods::certificate() const noexcept {
  return {.direction_error = direction_error_.value * options_.error_factor + 1e-9,
          .level = options_.certified_level};
}

std::unique_ptr<control::Controller> Methods::Make(std::string_view method,
                                                   const core::SimulatedPlant& plant) const {
  // Throws for an unknown name and lists the valid ones.
  static_cast<void>(ParseMethod(method, kPlanarMethods));
  if (!method.starts_with("certified") || !Split(method).support.empty()) {
    return controllers_.Make(method, &plant, {.guided = options_.guided});
  }
  return std::make_unique<control::CertifiedController>(
      policy_, model().view(),
      control::CertifiedOptions{.horizon = task_.horizon, .certificate = certificate()});
}

}  // namespace dfr::study::planar
