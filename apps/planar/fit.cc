#include "apps/planar/fit.h"

#include <vector>

#include "dfr/core/feature_transform.h"

namespace dfr::apps::planar {
namespace {

double ToleranceOf(const MethodOptions& options, double usual) {
  return options.tolerance > 0.0 ? options.tolerance : usual;
}

core::FeatureTransform Isotropic(const Task& task,
                                 std::span<const core::Trajectory> demonstrations) {
  const int n = task.plant->state_dim();
  const core::FeatureSelection all = core::FeatureSelection::All(n);
  std::vector<core::Matrix> states;
  states.reserve(demonstrations.size());
  for (const core::Trajectory& d : demonstrations) states.push_back(d.states);
  const core::FeatureTransform whitening =
      core::FeatureTransform::Whitening(all, states, {.decorrelate = false, .local = false});
  const double scale = static_cast<double>(n) / whitening.scale().diagonal().cwiseInverse().sum();
  return {all, Eigen::VectorXd::Zero(n), scale * core::Matrix::Identity(n, n)};
}

}  // namespace

safety::TaskOptions TaskOptionsOf(const Task& task, const MethodOptions& options) {
  kernel::TimeVaryingSupportOptions raw;
  raw.svm.gamma = options.raw_gamma > 0.0 ? options.raw_gamma : task.raw_gamma;
  raw.svm.tolerance = ToleranceOf(options, raw.svm.tolerance);
  safety::TaskOptions result;
  result.guided.svm.gamma = options.gamma;
  result.guided.svm.tolerance = ToleranceOf(options, 1e-6);
  result.guided.window = options.window;
  result.guided.phase_whitening = options.whitening && options.phase_whitening;
  result.guided.hold_ended = options.hold_ended;
  result.whitening.decorrelate = options.whitening;
  result.published = raw;
  result.horizon = task.horizon;
  return result;
}

safety::GuidedRecovery FitCertified(const Task& task,
                                    std::span<const core::Trajectory> demonstrations,
                                    const MethodOptions& options) {
  return {Isotropic(task, demonstrations),
          demonstrations,
          {.svm = {.gamma = options.certified_gamma, .tolerance = ToleranceOf(options, 1e-6)},
           .phase_whitening = false}};
}

control::Certificate CertificateOf(const Task& task, const safety::GuidedRecovery& certified,
                                   const control::EstimatedConstant& gain,
                                   const control::EstimatedConstant& direction_error, double factor,
                                   control::CertificateKind kind) noexcept {
  const double scale = certified.features().scale()(0, 0);
  // A known K needs no safety factor, but its two factors are rounded apart.
  const double trusted = task.gain > 0.0 ? task.gain * scale * (1.0 + 1e-12) : gain.value * factor;
  return {kind, trusted, direction_error.value * factor + 1e-9};
}

}  // namespace dfr::apps::planar
