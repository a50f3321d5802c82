#include "model.h"

#include <algorithm>
#include <charconv>
#include <limits>
#include <span>
#include <stdexcept>

#include "dfr/control/lambda.h"
#include "dfr/core/archive.h"
#include "dfr/core/contract.h"
#include "dfr/imitation/fit_mlp.h"

namespace dfr::apps {
namespace {

constexpr std::string_view kSwitchingKind = "pusher-switching";
constexpr int kSwitchingVersion = 1;

// The state of Sec. V-A at rest: without the entries that no controller of the paper saw.
constexpr std::string_view kPolicyFeatures = "qpos,tip,object,goal";

// Layers of 1 to 1024 units, four at the most: what a learner of this task may need.
constexpr int kMostUnits = 1024;
constexpr std::size_t kMostLayers = 4;

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
  for (const int units : hidden) name += (name.empty() ? "" : "-") + std::to_string(units);
  return name;
}

Model::Model(imitation::MlpPolicy policy, const core::FeatureSelection& features,
             kernel::TimeVaryingSupport support, std::vector<double> lambda, int horizon,
             int demonstrations)
    : policy_(std::make_unique<imitation::MlpPolicy>(std::move(policy))),
      support_(std::make_unique<kernel::TimeVaryingSupport>(std::move(support))),
      decision_(std::make_unique<core::FeatureDecision>(features, *support_)),
      feature_spec_(features.spec()),
      lambda_(std::move(lambda)),
      horizon_(horizon),
      demonstrations_(demonstrations) {}

Model Model::Fit(const imitation::DemonstrationSet& set, int demonstrations,
                 const ModelOptions& options) {
  DFR_THROW_UNLESS(
      demonstrations >= 2 && static_cast<std::size_t>(demonstrations) <= set.trajectories.size(),
      "cannot fit to " << demonstrations << " demonstrations: there are " << set.trajectories.size()
                       << ", and 2 are needed");
  const auto used = std::span(set.trajectories).first(static_cast<std::size_t>(demonstrations));

  imitation::FitMlpOptions fit;
  fit.hidden = options.learner.hidden;
  fit.epochs = options.learner.epochs;
  fit.learning_rate = options.learner.learning_rate;
  fit.features = kPolicyFeatures;
  fit.seed = options.seed;
  imitation::DemonstrationSet some = set;
  some.trajectories.assign(used.begin(), used.end());
  imitation::MlpPolicy policy = imitation::FitMlp(some, fit);

  const core::FeatureSelection features(set.layout, options.support_features);
  std::vector<core::Matrix> supported;
  supported.reserve(used.size());
  for (const core::Trajectory& trajectory : used) {
    supported.push_back(features.Apply(trajectory.states));
  }
  kernel::TimeVaryingSupportOptions support_options;
  support_options.svm.nu = options.nu;
  support_options.svm.gamma = options.gamma;
  support_options.num_steps = options.horizon + 1;
  kernel::TimeVaryingSupport support = kernel::TimeVaryingSupport::Fit(supported, support_options);
  const core::FeatureDecision decision(features, support);
  std::vector<double> lambda = control::EstimateLambda(decision, used);
  return Model(std::move(policy), features, std::move(support), std::move(lambda), options.horizon,
               demonstrations);
}

void Model::Save(const std::filesystem::path& folder) const {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    throw std::runtime_error(folder.string() + ": the folder cannot be made: " + error.message());
  }
  policy_->Save(folder / "policy.dfr");
  support_->Save(folder / "support.dfr");
  core::ArchiveWriter switching(kSwitchingKind, kSwitchingVersion);
  switching.Text(feature_spec_);
  switching.Numbers(lambda_);
  switching.Integer(horizon_);
  switching.Integer(demonstrations_);
  switching.Save(folder / "switching.dfr");
}

Model Model::Load(const std::filesystem::path& folder) {
  imitation::MlpPolicy policy = imitation::MlpPolicy::Load(folder / "policy.dfr");
  kernel::TimeVaryingSupport support = kernel::TimeVaryingSupport::Load(folder / "support.dfr");
  core::ArchiveReader switching(folder / "switching.dfr", kSwitchingKind, kSwitchingVersion);
  const std::string spec = switching.Text();
  std::vector<double> lambda = switching.Numbers();
  const int horizon = switching.IntegerIn(1, 1'000'000);
  const int demonstrations = switching.IntegerIn(1, std::numeric_limits<int>::max());
  switching.End();
  try {
    const core::FeatureSelection features(policy.layout(), spec);
    return Model(std::move(policy), features, std::move(support), std::move(lambda), horizon,
                 demonstrations);
  } catch (const std::invalid_argument& e) {
    switching.Fail(std::string("does not fit the other files of this model: ") + e.what());
  }
}

control::SwitchingPolicy Model::MakeController(control::Recovery recovery,
                                               const core::SimulatedPlant* oracle_plant) const {
  control::SwitchingPolicyOptions options;
  options.recovery = recovery;
  options.horizon = horizon_;
  options.oracle_plant = oracle_plant;
  return {*policy_, *decision_, lambda_, options};
}

}  // namespace dfr::apps
