#include "apps/planar/methods.h"

#include <utility>

#include "dfr/control/lambda.h"
#include "dfr/control/switching_policy.h"
#include "dfr/core/contract.h"

namespace dfr::apps::planar {
namespace {

std::vector<core::Matrix> States(std::span<const core::Trajectory> demonstrations) {
  std::vector<core::Matrix> states;
  for (const auto& d : demonstrations) states.push_back(d.states);
  return states;
}

std::vector<core::Matrix> Features(const core::FeatureTransform& features,
                                   std::span<const core::Trajectory> demonstrations) {
  std::vector<core::Matrix> points;
  for (const auto& d : demonstrations) points.push_back(features.Apply(d.states));
  return points;
}

core::FeatureSelection All(const Task& task) {
  return core::FeatureSelection::All(task.plant->state_dim());
}

// One common scale for all entries, so that |dz| is |dx| up to that factor.
core::FeatureTransform Isotropic(const Task& task,
                                 std::span<const core::Trajectory> demonstrations) {
  const int n = task.plant->state_dim();
  const core::FeatureTransform whitening =
      core::FeatureTransform::Whitening(All(task), States(demonstrations), {.decorrelate = false});
  const double scale = static_cast<double>(n) / whitening.scale().diagonal().cwiseInverse().sum();
  return {All(task), Eigen::VectorXd::Zero(n), scale * core::Matrix::Identity(n, n)};
}

}  // namespace

Methods::Methods(const Task& task, std::vector<core::Trajectory> demonstrations,
                 const MethodOptions& options)
    : task_(task),
      options_(options),
      demonstrations_(std::move(demonstrations)),
      policy_(demonstrations_, task.degree),
      raw_(kernel::TimeVaryingSupport::Fit(
          States(demonstrations_),
          {.svm = {.gamma = options.raw_gamma > 0.0 ? options.raw_gamma : task.raw_gamma}})) {
  lambda_ = control::EstimateLambda(raw_, demonstrations_);

  const std::vector<core::Matrix> states = States(demonstrations_);
  const core::FeatureTransform features =
      core::FeatureTransform::Whitening(All(task), states, {.decorrelate = options.whitening});
  const kernel::WhitenedSupportOptions whitened{
      .svm = {.gamma = options.gamma, .tolerance = 1e-6},
      .window = options.window,
      .phase_whitening = options.whitening && options.phase_whitening,
      .hold_ended = options.hold_ended};
  const std::vector<core::Matrix> points = Features(features, demonstrations_);
  support_ =
      std::make_unique<kernel::WhitenedSupport>(kernel::WhitenedSupport::Fit(points, whitened));
  model_ = std::make_unique<control::GuidedModel>(
      features, *support_, demonstrations_,
      control::GuidedModelOptions{.slack =
                                      control::SlackFrom(kernel::HeldOutLevels(points, whitened))});
  lwr_ = std::make_unique<imitation::LocallyWeightedPolicy>(features, demonstrations_);

  const core::FeatureTransform plain = Isotropic(task, demonstrations_);
  certified_support_ = std::make_unique<kernel::WhitenedSupport>(kernel::WhitenedSupport::Fit(
      Features(plain, demonstrations_),
      {.svm = {.gamma = options.certified_gamma, .tolerance = 1e-6}, .phase_whitening = false}));
  certified_model_ =
      std::make_unique<control::GuidedModel>(plain, *certified_support_, demonstrations_);
  gain_ = control::EstimateGain(plain, demonstrations_);
  direction_error_ = control::EstimateDirectionError(plain, demonstrations_);
}

SupportKind SupportOf(std::string_view method) {
  if (method.starts_with("guided")) return SupportKind::kGuided;
  if (method.starts_with("certified")) return SupportKind::kCertified;
  return SupportKind::kRaw;
}

double Methods::Level(SupportKind kind, int t, std::span<const double> x) const {
  if (kind == SupportKind::kRaw) return raw_.LogDecision(t, x, {});
  const control::GuidedModel& guided = model(kind);
  std::vector<double> z(static_cast<std::size_t>(guided.features().num_features()));
  guided.features().Apply(x, z);
  return guided.support().LogDecision(t, z, {});
}

control::Certificate Methods::certificate(control::CertificateKind kind) const noexcept {
  const double scale = certified_model_->features().scale()(0, 0);
  // A known K needs no safety factor, but its two factors are rounded apart.
  const double gain =
      task_.gain > 0.0 ? task_.gain * scale * (1.0 + 1e-12) : gain_.value * options_.gain_factor;
  return {kind, gain, direction_error_.value * options_.gain_factor + 1e-9};
}

std::unique_ptr<control::Controller> Methods::Make(std::string_view method,
                                                   const core::SimulatedPlant& plant) const {
  for (const auto recovery : {control::Recovery::kNone, control::Recovery::kEarlyStopping,
                              control::Recovery::kDfr, control::Recovery::kFiniteDifference}) {
    if (method == control::Name(recovery)) {
      return std::make_unique<control::SwitchingPolicy>(
          policy_, raw_, lambda_,
          control::SwitchingPolicyOptions{
              .recovery = recovery, .horizon = task_.horizon, .oracle_plant = &plant});
    }
  }
  if (method == "lwr") {
    return std::make_unique<control::SwitchingPolicy>(
        *lwr_, raw_, lambda_,
        control::SwitchingPolicyOptions{.recovery = control::Recovery::kNone,
                                        .horizon = task_.horizon});
  }
  control::GuidedOptions options = options_.guided;
  options.horizon = task_.horizon;
  if (method == "guided") {
    return std::make_unique<control::GuidedPolicy>(policy_, *model_, options);
  }
  if (method == "guided-lwr") {
    return std::make_unique<control::GuidedPolicy>(policy_, *model_, options, lwr_.get());
  }
  for (const auto kind : {control::CertificateKind::kLipschitz, control::CertificateKind::kRadius,
                          control::CertificateKind::kDirection}) {
    if (method == control::Name(kind)) {
      options.certificate = certificate(kind);
      return std::make_unique<control::GuidedPolicy>(policy_, *certified_model_, options);
    }
  }
  constexpr std::string_view kWithout = "guided-without-";
  if (method.starts_with(kWithout)) {
    for (const control::GuidedPartName& part : control::GuidedPartNames()) {
      if (method.substr(kWithout.size()) != part.name) continue;
      options.parts.*part.part = false;
      return std::make_unique<control::GuidedPolicy>(policy_, *model_, options);
    }
  }
  DFR_THROW_UNLESS(false, "there is no method '" << method << "'");
  return nullptr;
}

}  // namespace dfr::apps::planar
