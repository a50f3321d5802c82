#include "model.h"

#include <algorithm>
#include <optional>
#include <string_view>

#include "apps/inputs.h"
#include "dfr/core/contract.h"
#include "dfr/core/text/numbers.h"
#include "dfr/imitation/fit_mlp.h"

namespace dfr::apps::pusher {
namespace {

// The state of Sec. V-A at rest, without the entries that the paper's controllers do not observe.
constexpr std::string_view kPolicyFeatures = "qpos,tip,object,goal";

// Features of guided recovery's support: position of the cylinder, pose of the gripper.
constexpr std::string_view kGuidedFeatures = "object[0:2],tip,tip_tilt";

// Limits of Learner::Parse().
constexpr int kMostUnits = 1024;
constexpr std::size_t kMostLayers = 4;
constexpr int kMostEpochs = 100'000;

safety::TaskOptions GuidedOptions(double gamma) {
  safety::TaskOptions options;
  options.guided_features = kGuidedFeatures;
  options.guided.svm.gamma = gamma;
  options.guided.single_precision = true;
  return options;
}

}  // namespace

Learner Learner::Parse(const std::string& name) {
  Learner learner;
  learner.hidden.clear();
  const auto whole = [&](std::size_t begin, std::size_t end, int most) {
    const std::optional<int> number =
        core::ParseInteger<int>(std::string_view(name).substr(begin, end - begin));
    DFR_THROW_UNLESS(
        number && *number >= 1 && *number <= most && learner.hidden.size() < kMostLayers,
        "learner '" << name << "': write the units of each hidden layer, as in 8 or "
                    << "64-64 (1 to " << kMostLayers
                    << " layers), and after an x the epochs, as in 8x100");
    return *number;
  };
  const std::size_t layers = std::min(name.find('x'), name.size());
  if (layers < name.size()) learner.epochs = whole(layers + 1, name.size(), kMostEpochs);
  for (std::size_t begin = 0; begin <= layers;) {
    const std::size_t end = std::min(name.find('-', begin), layers);
    learner.hidden.push_back(whole(begin, end, kMostUnits));
    begin = end + 1;
  }
  return learner;
}

std::string Learner::Name() const {
  std::string name;
  for (const int units : hidden) {
    if (!name.empty()) name += '-';
    name += std::to_string(units);
  }
  return name;
}

Model Model::Fit(const imitation::DemonstrationSet& set, int demonstrations,
                 const ModelOptions& options, const imitation::GaussianPolicy* supervisor,
                 const sim::PusherOptions& scene) {
  DFR_THROW_UNLESS(
      demonstrations >= 3 && static_cast<std::size_t>(demonstrations) <= set.trajectories.size(),
      "cannot fit to " << demonstrations << " demonstrations: there are " << set.trajectories.size()
                       << ", and 3 are needed");
  imitation::DemonstrationSet some = set;
  some.trajectories.resize(static_cast<std::size_t>(demonstrations));

  imitation::FitMlpOptions fit;
  fit.hidden = options.learner.hidden;
  fit.epochs = options.learner.epochs.value_or(options.epochs);
  fit.learning_rate = options.learner.learning_rate;
  fit.features = kPolicyFeatures;
  fit.seed = options.seed;

  kernel::TimeVaryingSupportOptions published;
  published.svm.nu = options.nu;
  published.svm.gamma = options.gamma;
  published.num_steps = options.horizon + 1;
  safety::TaskOptions task = GuidedOptions(options.whitened_gamma);
  task.published_features = options.support_features;
  task.published = published;
  task.horizon = options.horizon;
  imitation::MlpPolicy policy = imitation::FitMlp(some, fit);
  safety::TaskModel model(set.layout, some.trajectories, task);
  study::Expert teaching = study::TeachMlp(some, fit);
  if (supervisor != nullptr) {
    teaching.plant = std::make_shared<sim::PusherPlant>(scene);
    teaching.supervise = [mean = std::make_shared<imitation::MlpPolicy>(supervisor->mean())](
                             const core::SimulatedPlant& plant, int t, std::uint64_t /*episode*/,
                             std::span<double> u) {
      std::vector<double> x(static_cast<std::size_t>(plant.state_dim()));
      plant.Observe(x);
      mean->Control(t, x, u);
    };
  }
  return {study::LearnedModel(std::move(policy), std::move(model), std::move(some),
                              std::move(teaching))};
}

Model Model::Load(const std::filesystem::path& folder) {
  MustExist(folder / "policy.dfr",
            "Run `pusher fit` first, or give the folder of a model with --model");
  return {study::LearnedModel::Load(folder)};
}

std::unique_ptr<control::Controller> Model::MakeController(const safety::Method& method,
                                                           const core::SimulatedPlant* plant,
                                                           int first_step) const {
  return controllers().Make(method.name, plant, {.first_step = first_step});
}

}  // namespace dfr::apps::pusher
