#include "model.h"

#include <stdexcept>
#include <string_view>
#include <utility>

#include "dfr/control/lambda.h"
#include "dfr/core/archive.h"
#include "dfr/core/contract.h"
#include "dfr/imitation/fit_mlp.h"

namespace dfr::apps {
namespace {

constexpr std::string_view kSwitchingKind = "line-tracking-switching";
constexpr int kSwitchingVersion = 1;

}  // namespace

LineModel::LineModel(imitation::MlpPolicy policy, const core::FeatureSelection& features,
                     kernel::TimeVaryingSupport support, std::vector<double> lambda, double gamma,
                     int horizon)
    : policy_(std::make_unique<imitation::MlpPolicy>(std::move(policy))),
      support_(std::make_unique<kernel::TimeVaryingSupport>(std::move(support))),
      decision_(std::make_unique<core::FeatureDecision>(features, *support_)),
      feature_spec_(features.spec()),
      lambda_(std::move(lambda)),
      gamma_(gamma),
      horizon_(horizon) {}

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
  return {std::move(policy),         features,       std::move(support), std::move(lambda),
          support_options.svm.gamma, options.horizon};
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
  switching.Save(folder / "switching.dfr");
}

LineModel LineModel::Load(const std::filesystem::path& folder) {
  imitation::MlpPolicy policy = imitation::MlpPolicy::Load(folder / "policy.dfr");
  kernel::TimeVaryingSupport support = kernel::TimeVaryingSupport::Load(folder / "support.dfr");
  core::ArchiveReader switching(folder / "switching.dfr", kSwitchingKind, kSwitchingVersion);
  const std::string spec = switching.Text();
  std::vector<double> lambda = switching.Numbers();
  const double gamma = switching.Number();
  const int horizon = switching.IntegerIn(1, 1'000'000);
  switching.End();
  try {
    const core::FeatureSelection features(policy.layout(), spec);
    return {std::move(policy), features, std::move(support), std::move(lambda), gamma, horizon};
  } catch (const std::invalid_argument& e) {
    switching.Fail(std::string("does not fit the other files of this model: ") + e.what());
  }
}

control::SwitchingPolicy LineModel::MakeController(
    const control::SwitchingPolicyOptions& options) const {
  control::SwitchingPolicyOptions complete = options;
  complete.horizon = horizon_;
  return {*policy_, *decision_, lambda_, complete};
}

}  // namespace dfr::apps
