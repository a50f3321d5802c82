#include "model.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <string_view>
#include <utility>

#include "apps/inputs.h"
#include "dfr/core/contract.h"
#include "dfr/imitation/fit_mlp.h"

namespace dfr::apps::line_tracking {
namespace {

// Features of guided recovery's support: the progress (tip's x) and the distance to the line. The
// tip's y is left out, as in Algorithm 1's support, because the platform moves the line.
constexpr std::string_view kGuidedFeatures = "tip[0:1],distance";

// Policy of the method "proportional".
class Proportional final : public core::Policy {
 public:
  [[nodiscard]] int state_dim() const noexcept override { return 4; }
  [[nodiscard]] int control_dim() const noexcept override { return 2; }
  void Control(int /*t*/, std::span<const double> x, std::span<double> u) const noexcept override {
    constexpr double kForward = 1.0;  // mm per control
    constexpr double kGain = 0.8;
    constexpr double kUnit = 2.0;        // mm per unit of control
    constexpr double kPerRadian = 10.0;  // mm per rad, scale of the state's heading
    const double angle = x[3] / kPerRadian;
    const double aside = -kGain * x[2];
    u[0] = std::clamp((kForward * std::cos(angle) - aside * std::sin(angle)) / kUnit, -1.0, 1.0);
    u[1] = std::clamp((kForward * std::sin(angle) + aside * std::cos(angle)) / kUnit, -1.0, 1.0);
  }
};

safety::TaskOptions GuidedOptions(double gamma) {
  safety::TaskOptions options;
  options.guided_features = kGuidedFeatures;
  options.guided.svm.gamma = gamma;
  return options;
}

}  // namespace

const core::Policy& ProportionalPolicy() noexcept {
  static const Proportional policy;
  return policy;
}

safety::ControllerOptions Controllers() {
  safety::ControllerOptions options;
  // Algorithm 1 requires only |u_delta| << g / lambda and eta < g / lambda. The constants of the
  // paper's simulations are below the resolution of an image.
  options.dfr.probe_fraction = 0.1;
  options.dfr.step_fraction = 0.5;
  // The platform moves during each control and during the rest of the arm between two controls.
  // This rest is assumed to take half of the 0.1 s of an ordinary control (--pause is 0.05 s by
  // default).
  options.guided.disturbance_model = {.base = 0.5, .per_control = 1.0};
  // A probe must move the tool by more than the platform moves the line at the same time.
  options.guided.probe_size = 1.0;
  return options;
}

LineModel LineModel::Fit(const imitation::DemonstrationSet& set, const LineModelOptions& options,
                         kernel::Selection* selection) {
  DFR_THROW_UNLESS(set.trajectories.size() >= 8,
                   "cannot fit to " << set.trajectories.size()
                                    << " demonstrations: at least 8 are needed, to hold some out");
  DFR_THROW_UNLESS(!options.gammas.empty(), "gammas is empty: give at least one to choose from");
  imitation::FitMlpOptions fit;
  fit.hidden = options.hidden;
  fit.method = imitation::FitMethod::kLbfgs;
  fit.weight_decay = 1e-4;
  fit.max_iterations = 200;
  fit.seed = options.seed;
  imitation::MlpPolicy policy = imitation::FitMlp(set, fit);

  const core::FeatureSelection features(set.layout, options.support_features);
  std::vector<core::Matrix> states;
  for (const core::Trajectory& trajectory : set.trajectories) {
    states.push_back(features.Apply(trajectory.states));
  }
  kernel::TimeVaryingSupportOptions support_options;
  support_options.svm.nu = options.nu;
  support_options.svm.gamma = options.gammas.front();
  if (options.gammas.size() > 1) {
    kernel::SelectionOptions candidates;
    candidates.gammas = options.gammas;
    candidates.nus = {options.nu};
    candidates.acceptance = options.acceptance;
    candidates.support = support_options;
    candidates.seed = options.seed;
    kernel::Selection chosen = kernel::SelectModel(states, candidates);
    support_options.svm.gamma = chosen.rows[chosen.chosen].gamma;
    if (selection != nullptr) *selection = std::move(chosen);
  }
  safety::TaskOptions task = GuidedOptions(options.whitened_gamma);
  task.published_features = options.support_features;
  task.published = support_options;
  task.horizon = options.horizon;
  return {study::LearnedModel(std::move(policy),
                              safety::TaskModel(set.layout, set.trajectories, task), set,
                              study::TeachMlp(set, fit))};
}

LineModel LineModel::Load(const std::filesystem::path& folder) {
  MustExist(folder / "policy.dfr",
            "Run `line_tracking fit` first, or give the folder of a model with --model");
  return {study::LearnedModel::Load(folder)};
}

std::unique_ptr<control::Controller> LineModel::MakeController(
    const std::string& method, const core::SimulatedPlant* plant) const {
  const safety::Method parsed = study::ParseMethod(method, kOtherLineMethods);
  if (parsed.name == "proportional") {
    return task().MakeController({.name = "baseline"}, ProportionalPolicy(), Controllers());
  }
  return controllers().Make(method, plant, Controllers());
}

}  // namespace dfr::apps::line_tracking
