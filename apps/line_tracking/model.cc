#include "model.h"

#include <array>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "dfr/control/lambda.h"
#include "dfr/core/archive.h"
#include "dfr/core/contract.h"
#include "dfr/imitation/fit_mlp.h"

namespace dfr::apps::line_tracking {
namespace {

constexpr std::string_view kSwitchingKind = "line-tracking-switching";
constexpr int kSwitchingVersion = 2;

// What guided recovery's support looks at: the progress, and what the task is about. The tip's y is
// left out as in Algorithm 1's: the platform carries the line away.
constexpr std::string_view kGuidedFeatures = "tip[0:1],distance";

constexpr std::array kRecoveries = {control::Recovery::kNone, control::Recovery::kEarlyStopping,
                                    control::Recovery::kDfr};
constexpr std::string_view kDfrFine = "dfr-fine";
constexpr std::string_view kWithout = "guided-without-";
constexpr std::string_view kWithoutDrift = "guided-without-drift";

kernel::WhitenedSupportOptions GuidedSupportOptions(double gamma) {
  kernel::WhitenedSupportOptions options;
  options.svm.gamma = gamma;
  return options;
}

}  // namespace

Method Method::Parse(const std::string& name) {
  Method method;
  method.name = name;
  std::string known;
  for (const control::Recovery recovery : kRecoveries) {
    method.switching.recovery = recovery;
    if (recovery == control::Recovery::kDfr) {
      // Algorithm 1 asks for |u_delta| << g / lambda and eta < g / lambda, no more. The constants
      // of the paper's simulations are below what an image can tell.
      if (name == kDfrFine) return method;
      method.switching.dfr.probe_fraction = 0.1;
      method.switching.dfr.step_fraction = 0.5;
    }
    if (name == control::Name(recovery)) return method;
    known.append(control::Name(recovery)).append(", ");
  }
  method.guided = true;
  // Being careful outside the support, and content with offsets that seem to stay, is for objects
  // that a control may knock over or not reach. Here the platform moves on meanwhile.
  control::GuidedOptions& recovery = method.recovery;
  recovery.parts.gentle_outside = false;
  recovery.parts.slack = false;
  // The platform moves on during each control, and for as long as the arm rests between two: half
  // of the 0.1 s that an ordinary control takes is near enough (--pause is 0.05 s by default).
  recovery.drift_time = {.rest = 0.5, .travel = 1.0};
  // A probe must move the tool by more than the platform moves the line meanwhile.
  recovery.probe_size = 1.0;
  if (name == "guided") return method;
  known.append(kDfrFine).append(", guided, ").append(kWithoutDrift);
  if (name == kWithoutDrift) {
    recovery.drift_time = {};
    return method;
  }
  for (const control::GuidedPartName& part : control::GuidedPartNames()) {
    const std::string without = std::string(kWithout).append(part.name);
    if (name == without) {
      recovery.parts.*part.part = false;
      return method;
    }
    known.append(", ").append(without);
  }
  throw std::invalid_argument("there is no method '" + name + "'; there are: " + known);
}

LineModel::LineModel(imitation::MlpPolicy policy, const core::FeatureSelection& features,
                     kernel::TimeVaryingSupport support, std::vector<double> lambda, double gamma,
                     int horizon, double guided_gamma, imitation::DemonstrationSet set)
    : policy_(std::make_unique<imitation::MlpPolicy>(std::move(policy))),
      support_(std::make_unique<kernel::TimeVaryingSupport>(std::move(support))),
      decision_(std::make_unique<core::FeatureDecision>(features, *support_)),
      feature_spec_(features.spec()),
      lambda_(std::move(lambda)),
      gamma_(gamma),
      horizon_(horizon),
      guided_gamma_(guided_gamma),
      set_(std::move(set)),
      guided_(std::make_unique<safety::GuidedRecovery>(
          core::FeatureSelection(set_.layout, kGuidedFeatures), set_.trajectories,
          GuidedSupportOptions(guided_gamma))) {}

LineModel LineModel::Fit(const imitation::DemonstrationSet& set, const LineModelOptions& options,
                         kernel::Selection* selection) {
  DFR_THROW_UNLESS(set.trajectories.size() >= 8,
                   "cannot fit to " << set.trajectories.size()
                                    << " demonstrations: 8 are needed, of which some are held out");
  DFR_THROW_UNLESS(!options.gammas.empty(), "there is no gamma to choose from");
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
  kernel::TimeVaryingSupport support = kernel::TimeVaryingSupport::Fit(states, support_options);
  const core::FeatureDecision decision(features, support);
  std::vector<double> lambda = control::EstimateLambda(decision, set.trajectories);
  return {std::move(policy),         features,        std::move(support),   std::move(lambda),
          support_options.svm.gamma, options.horizon, options.guided_gamma, set};
}

void LineModel::Save(const std::filesystem::path& folder) const {
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
  switching.Number(gamma_);
  switching.Integer(horizon_);
  switching.Number(guided_gamma_);
  switching.Save(folder / "switching.dfr");
  imitation::SaveRobomimic(set_, folder / "demonstrations.hdf5");
}

LineModel LineModel::Load(const std::filesystem::path& folder) {
  imitation::MlpPolicy policy = imitation::MlpPolicy::Load(folder / "policy.dfr");
  kernel::TimeVaryingSupport support = kernel::TimeVaryingSupport::Load(folder / "support.dfr");
  core::ArchiveReader switching(folder / "switching.dfr", kSwitchingKind, kSwitchingVersion);
  const std::string spec = switching.Text();
  std::vector<double> lambda = switching.Numbers();
  const double gamma = switching.Number();
  const int horizon = switching.IntegerIn(1, 1'000'000);
  const double guided_gamma = switching.Number();
  switching.End();
  imitation::DemonstrationSet set = imitation::LoadRobomimic(folder / "demonstrations.hdf5");
  try {
    const core::FeatureSelection features(policy.layout(), spec);
    return {std::move(policy), features,     std::move(support), std::move(lambda), gamma,
            horizon,           guided_gamma, std::move(set)};
  } catch (const std::invalid_argument& e) {
    switching.Fail(std::string("does not fit the other files of this model: ") + e.what());
  }
}

std::unique_ptr<control::Controller> LineModel::MakeController(const Method& method) const {
  if (method.guided) {
    control::GuidedOptions options = method.recovery;
    options.horizon = horizon_;
    return std::make_unique<control::GuidedPolicy>(*policy_, guided_->model(), options);
  }
  control::SwitchingPolicyOptions options = method.switching;
  options.horizon = horizon_;
  return std::make_unique<control::SwitchingPolicy>(*policy_, *decision_, lambda_, options);
}

}  // namespace dfr::apps::line_tracking
