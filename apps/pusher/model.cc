#include "model.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <stdexcept>

#include "dfr/control/finite_difference_recovery.h"
#include "dfr/core/contract.h"
#include "dfr/imitation/fit_mlp.h"

namespace dfr::apps::pusher {
namespace {

// The state of Sec. V-A at rest: without the entries that no controller of the paper saw.
constexpr std::string_view kPolicyFeatures = "qpos,tip,object,goal";

// What guided recovery's support looks at: where the cylinder is, and where and how the gripper.
constexpr std::string_view kGuidedFeatures = "object[0:2],tip,tip_tilt";

// Layers of 1 to 1024 units, four at the most: what a learner of this task may need.
constexpr int kMostUnits = 1024;
constexpr std::size_t kMostLayers = 4;

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
  std::size_t begin = 0;
  while (begin <= name.size()) {
    const std::size_t end = std::min(name.find('-', begin), name.size());
    int units = 0;
    const auto [stop, error] = std::from_chars(name.data() + begin, name.data() + end, units);
    DFR_THROW_UNLESS(error == std::errc() && stop == name.data() + end && units >= 1 &&
                         units <= kMostUnits && learner.hidden.size() < kMostLayers,
                     "learner '" << name << "': write the units of each hidden layer, as in 8 or "
                                 << "64-64 (1 to " << kMostLayers << " layers)");
    learner.hidden.push_back(units);
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

safety::Method ParseMethod(const std::string& name) {
  return safety::ParseMethod(name, kOtherMethods);
}

Model::Model(imitation::MlpPolicy policy, safety::TaskModel task, imitation::DemonstrationSet set)
    : policy_(std::make_unique<imitation::MlpPolicy>(std::move(policy))),
      task_(std::move(task)),
      set_(std::make_unique<imitation::DemonstrationSet>(std::move(set))),
      locally_weighted_(std::make_unique<imitation::LocallyWeightedPolicy>(
          task_.guided().features(), set_->trajectories)) {}

Model Model::Fit(const imitation::DemonstrationSet& set, int demonstrations,
                 const ModelOptions& options) {
  DFR_THROW_UNLESS(
      demonstrations >= 3 && static_cast<std::size_t>(demonstrations) <= set.trajectories.size(),
      "cannot fit to " << demonstrations << " demonstrations: there are " << set.trajectories.size()
                       << ", and 3 are needed");
  imitation::DemonstrationSet some = set;
  some.trajectories.resize(static_cast<std::size_t>(demonstrations));

  imitation::FitMlpOptions fit;
  fit.hidden = options.learner.hidden;
  fit.epochs = options.learner.epochs;
  fit.learning_rate = options.learner.learning_rate;
  fit.features = kPolicyFeatures;
  fit.seed = options.seed;

  kernel::TimeVaryingSupportOptions published;
  published.svm.nu = options.nu;
  published.svm.gamma = options.gamma;
  published.num_steps = options.horizon + 1;
  safety::TaskOptions task = GuidedOptions(options.guided_gamma);
  task.published_features = options.support_features;
  task.published = published;
  task.horizon = options.horizon;
  imitation::MlpPolicy policy = imitation::FitMlp(some, fit);
  safety::TaskModel model(set.layout, some.trajectories, task);
  return {std::move(policy), std::move(model), std::move(some)};
}

void Model::Save(const std::filesystem::path& folder) const {
  task_.Save(folder);
  policy_->Save(folder / "policy.dfr");
  imitation::SaveRobomimic(*set_, folder / "demonstrations.hdf5");
}

Model Model::Load(const std::filesystem::path& folder) {
  imitation::MlpPolicy policy = imitation::MlpPolicy::Load(folder / "policy.dfr");
  imitation::DemonstrationSet set = imitation::LoadRobomimic(folder / "demonstrations.hdf5");
  safety::TaskModel task =
      safety::TaskModel::IsSavedIn(folder)
          ? safety::TaskModel::Load(folder, policy.layout())
          : safety::TaskModel::LoadSwitching(folder, "pusher-switching", policy.layout(),
                                             set.trajectories, GuidedOptions(0.0));
  return {std::move(policy), std::move(task), std::move(set)};
}

std::unique_ptr<control::Controller> Model::MakeController(const safety::Method& method,
                                                           const core::SimulatedPlant* plant,
                                                           int first_step) const {
  const safety::ControllerOptions options{.first_step = first_step};
  if (method.name == "lwr") {
    return task_.MakeController({.name = "baseline"}, *locally_weighted_, options);
  }
  if (method.kind != safety::Method::Kind::kOther) {
    return task_.MakeController(method, *policy_, options);
  }
  DFR_THROW_UNLESS(plant != nullptr, "the finite-difference oracle needs the plant it drives");
  return task_.MakeController(
      std::make_unique<control::FiniteDifferenceRecovery>(*plant, task_.support()), *policy_,
      options);
}

}  // namespace dfr::apps::pusher
