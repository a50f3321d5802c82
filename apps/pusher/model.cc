#include "model.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <stdexcept>

#include "dfr/control/lambda.h"
#include "dfr/core/archive.h"
#include "dfr/core/contract.h"
#include "dfr/imitation/fit_mlp.h"

namespace dfr::apps::pusher {
namespace {

constexpr std::string_view kSwitchingKind = "pusher-switching";
constexpr int kSwitchingVersion = 2;

// The state of Sec. V-A at rest: without the entries that no controller of the paper saw.
constexpr std::string_view kPolicyFeatures = "qpos,tip,object,goal";

// What guided recovery's support looks at: where the cylinder is, and where and how the gripper.
constexpr std::string_view kGuidedFeatures = "object[0:2],tip,tip_tilt";

constexpr std::array kRecoveries = {control::Recovery::kNone, control::Recovery::kEarlyStopping,
                                    control::Recovery::kDfr, control::Recovery::kFiniteDifference};
constexpr std::string_view kWithout = "guided-without-";

// Layers of 1 to 1024 units, four at the most: what a learner of this task may need.
constexpr int kMostUnits = 1024;
constexpr std::size_t kMostLayers = 4;

kernel::WhitenedSupportOptions GuidedSupportOptions(double gamma) {
  kernel::WhitenedSupportOptions options;
  options.svm.gamma = gamma;
  options.single_precision = true;
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

Method Method::Parse(const std::string& name) {
  Method method{.name = name};
  std::string known;
  for (const control::Recovery recovery : kRecoveries) {
    method.recovery = recovery;
    if (name == control::Name(recovery)) return method;
    known.append(control::Name(recovery)).append(", ");
  }
  method.guided = true;
  method.locally_weighted = name == "guided-lwr";
  if (name == "guided" || method.locally_weighted) return method;
  known += "guided, guided-lwr";
  for (const control::GuidedPartName& part : control::GuidedPartNames()) {
    const std::string without = std::string(kWithout).append(part.name);
    if (name == without) {
      method.parts.*part.part = false;
      return method;
    }
    known.append(", ").append(without);
  }
  throw std::invalid_argument("there is no method '" + name + "'; there are: " + known);
}

Model::Model(imitation::MlpPolicy policy, const core::FeatureSelection& features,
             kernel::TimeVaryingSupport support, std::vector<double> lambda, int horizon,
             double guided_gamma, imitation::DemonstrationSet set)
    : policy_(std::make_unique<imitation::MlpPolicy>(std::move(policy))),
      support_(std::make_unique<kernel::TimeVaryingSupport>(std::move(support))),
      decision_(std::make_unique<core::FeatureDecision>(features, *support_)),
      feature_spec_(features.spec()),
      lambda_(std::move(lambda)),
      horizon_(horizon),
      guided_gamma_(guided_gamma),
      set_(std::make_unique<imitation::DemonstrationSet>(std::move(set))) {}

Model Model::Fit(const imitation::DemonstrationSet& set, int demonstrations,
                 const ModelOptions& options) {
  DFR_THROW_UNLESS(
      demonstrations >= 2 && static_cast<std::size_t>(demonstrations) <= set.trajectories.size(),
      "cannot fit to " << demonstrations << " demonstrations: there are " << set.trajectories.size()
                       << ", and 2 are needed");
  imitation::DemonstrationSet some = set;
  some.trajectories.resize(static_cast<std::size_t>(demonstrations));

  imitation::FitMlpOptions fit;
  fit.hidden = options.learner.hidden;
  fit.epochs = options.learner.epochs;
  fit.learning_rate = options.learner.learning_rate;
  fit.features = kPolicyFeatures;
  fit.seed = options.seed;
  imitation::MlpPolicy policy = imitation::FitMlp(some, fit);

  const core::FeatureSelection features(set.layout, options.support_features);
  std::vector<core::Matrix> supported;
  supported.reserve(some.trajectories.size());
  for (const core::Trajectory& trajectory : some.trajectories) {
    supported.push_back(features.Apply(trajectory.states));
  }
  kernel::TimeVaryingSupportOptions support_options;
  support_options.svm.nu = options.nu;
  support_options.svm.gamma = options.gamma;
  support_options.num_steps = options.horizon + 1;
  kernel::TimeVaryingSupport support = kernel::TimeVaryingSupport::Fit(supported, support_options);
  const core::FeatureDecision decision(features, support);
  std::vector<double> lambda = control::EstimateLambda(decision, some.trajectories);
  return Model(std::move(policy), features, std::move(support), std::move(lambda), options.horizon,
               options.guided_gamma, std::move(some));
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
  switching.Number(guided_gamma_);
  switching.Save(folder / "switching.dfr");
  imitation::SaveRobomimic(*set_, folder / "demonstrations.hdf5");
}

Model Model::Load(const std::filesystem::path& folder) {
  imitation::MlpPolicy policy = imitation::MlpPolicy::Load(folder / "policy.dfr");
  kernel::TimeVaryingSupport support = kernel::TimeVaryingSupport::Load(folder / "support.dfr");
  core::ArchiveReader switching(folder / "switching.dfr", kSwitchingKind, kSwitchingVersion);
  const std::string spec = switching.Text();
  std::vector<double> lambda = switching.Numbers();
  const int horizon = switching.IntegerIn(1, 1'000'000);
  const double guided_gamma = switching.Number();
  switching.End();
  imitation::DemonstrationSet set = imitation::LoadRobomimic(folder / "demonstrations.hdf5");
  try {
    const core::FeatureSelection features(policy.layout(), spec);
    return Model(std::move(policy), features, std::move(support), std::move(lambda), horizon,
                 guided_gamma, std::move(set));
  } catch (const std::invalid_argument& e) {
    switching.Fail(std::string("does not fit the other files of this model: ") + e.what());
  }
}

const safety::GuidedRecovery& Model::guided() {
  if (guided_ == nullptr) {
    guided_ = std::make_unique<safety::GuidedRecovery>(
        core::FeatureSelection(set_->layout, kGuidedFeatures), set_->trajectories,
        GuidedSupportOptions(guided_gamma_));
    locally_weighted_ =
        std::make_unique<imitation::LocallyWeightedPolicy>(guided_->features(), set_->trajectories);
  }
  return *guided_;
}

std::unique_ptr<control::Controller> Model::MakeController(const Method& method,
                                                           const core::SimulatedPlant* oracle_plant,
                                                           int first_step) {
  if (method.guided) {
    control::GuidedOptions options;
    options.parts = method.parts;
    options.horizon = horizon_;
    options.first_step = first_step;
    const control::GuidedModel& model = guided().model();
    return std::make_unique<control::GuidedPolicy>(
        *policy_, model, options, method.locally_weighted ? locally_weighted_.get() : nullptr);
  }
  control::SwitchingPolicyOptions options;
  options.recovery = method.recovery;
  options.horizon = horizon_;
  options.first_step = first_step;
  options.oracle_plant = oracle_plant;
  return std::make_unique<control::SwitchingPolicy>(*policy_, *decision_, lambda_, options);
}

}  // namespace dfr::apps::pusher
