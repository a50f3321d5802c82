#include "dfr/safety/task_model.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "dfr/control/published/lambda.h"
#include "dfr/core/contract.h"
#include "state_decision.h"

namespace dfr::safety {
namespace {

constexpr std::string_view kTaskKind = "task-model";
constexpr int kTaskVersion = 1;
constexpr std::string_view kTaskFile = "task.dfr";
constexpr std::string_view kSupportFile = "support.dfr";
constexpr int kMostHorizon = 1'000'000;

core::FeatureSelection Select(const core::StateLayout& layout, const std::string& spec) {
  return spec.empty() ? core::FeatureSelection::All(layout.state_dim())
                      : core::FeatureSelection(layout, spec);
}

std::optional<kernel::TimeVaryingSupport> FitPublished(
    const core::FeatureSelection& features, std::span<const core::Trajectory> demonstrations,
    const std::optional<kernel::TimeVaryingSupportOptions>& options) {
  if (!options) return std::nullopt;
  std::vector<core::Matrix> states;
  states.reserve(demonstrations.size());
  for (const core::Trajectory& demonstration : demonstrations) {
    states.push_back(features.Apply(demonstration.states));
  }
  return kernel::TimeVaryingSupport::Fit(states, *options);
}

}  // namespace

TaskModel::TaskModel(const core::StateLayout& layout,
                     std::span<const core::Trajectory> demonstrations, const TaskOptions& options)
    : TaskModel(
          std::make_shared<const GuidedRecovery>(Select(layout, options.guided_features),
                                                 demonstrations, options.guided, options.whitening),
          {1.0},
          FitPublished(Select(layout, options.published_features), demonstrations,
                       options.published),
          Select(layout, options.published_features), options.horizon) {
  lambda_ = control::EstimateLambda(support(), demonstrations);
}

TaskModel::TaskModel(std::shared_ptr<const GuidedRecovery> guided, std::vector<double> lambda,
                     std::optional<kernel::TimeVaryingSupport> published,
                     std::optional<core::FeatureSelection> published_features, int horizon)
    : guided_(std::move(guided)), lambda_(std::move(lambda)), horizon_(horizon) {
  DFR_THROW_UNLESS(horizon > 0 && horizon <= kMostHorizon,
                   "horizon must lie in [1, " << kMostHorizon << "], not be " << horizon);
  DFR_THROW_UNLESS(
      !lambda_.empty() && std::all_of(lambda_.begin(), lambda_.end(),
                                      [](double l) { return l > 0.0 && std::isfinite(l); }),
      "lambda must be positive and finite");
  guided_decision_ =
      std::make_unique<const internal::StateDecision>(guided_->features(), guided_->support());
  decision_ = guided_decision_.get();
  if (published) {
    DFR_THROW_UNLESS(published_features, "the published support needs its features");
    features_ = published_features->spec();
    published_ = std::make_unique<const kernel::TimeVaryingSupport>(*std::move(published));
    published_decision_ =
        std::make_unique<const core::FeatureDecision>(*std::move(published_features), *published_);
    decision_ = published_decision_.get();
  }
  DFR_THROW_UNLESS(decision_->state_dim() == guided_decision_->state_dim(),
                   "the published support takes states of " << decision_->state_dim()
                                                            << " entries, guided recovery's of "
                                                            << guided_decision_->state_dim());
}

TaskModel::TaskModel(TaskModel&&) noexcept = default;
TaskModel& TaskModel::operator=(TaskModel&&) noexcept = default;
TaskModel::~TaskModel() = default;

void TaskModel::Save(const std::filesystem::path& folder) const {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    throw std::runtime_error(folder.string() + ": the folder cannot be made: " + error.message());
  }
  if (published_ != nullptr) published_->Save(folder / kSupportFile);
  core::ArchiveWriter archive(kTaskKind, kTaskVersion);
  archive.Integer(published_ != nullptr ? 1 : 0);
  archive.Text(features_);
  archive.Text(guided_->features().selection().spec());
  archive.Numbers(lambda_);
  archive.Integer(horizon_);
  guided_->Save(archive);
  archive.Save(folder / kTaskFile);
}

TaskModel TaskModel::Load(const std::filesystem::path& folder, const core::StateLayout& layout) {
  core::ArchiveReader archive(folder / kTaskFile, kTaskKind, kTaskVersion);
  std::optional<kernel::TimeVaryingSupport> published;
  if (archive.IntegerIn(0, 1) == 1) {
    published = kernel::TimeVaryingSupport::Load(folder / kSupportFile);
  }
  const std::string published_features = archive.Text();
  const std::string guided_features = archive.Text();
  std::vector<double> lambda = archive.Numbers();
  const int horizon = archive.IntegerIn(1, kMostHorizon);
  try {
    std::shared_ptr<const GuidedRecovery> guided =
        GuidedRecovery::Load(archive, Select(layout, guided_features));
    archive.End();
    return {std::move(guided), std::move(lambda), std::move(published),
            Select(layout, published_features), horizon};
  } catch (const std::invalid_argument& e) {
    archive.Fail(std::string("does not fit the other files of this model: ") + e.what());
  }
}

std::unique_ptr<control::Controller> TaskModel::MakeController(
    const Method& method, const core::Policy& policy, const ControllerOptions& options) const {
  DFR_THROW_UNLESS(method.kind != Method::Kind::kOther,
                   "the method '" << method.name << "' is not one of a task model");
  if (method.kind == Method::Kind::kGuided) {
    control::GuidedOptions guided = control::Without(options.guided, method.without);
    guided.horizon = options.horizon != 0 ? options.horizon : horizon_;
    guided.first_step = options.first_step;
    return std::make_unique<control::GuidedPolicy>(policy, guided_->model(), guided);
  }
  const control::SwitchingPolicyOptions switching{
      .recovery = method.recovery,
      .horizon = options.horizon != 0 ? options.horizon : horizon_,
      .first_step = options.first_step,
      .dfr = method.published_dfr ? control::DfrOptions{} : options.dfr};
  return std::make_unique<control::SwitchingPolicy>(policy, support(), lambda_, switching);
}

std::unique_ptr<control::Controller> TaskModel::MakeController(
    std::unique_ptr<control::RecoveryStrategy> strategy, const core::Policy& policy,
    const ControllerOptions& options) const {
  return std::make_unique<control::SwitchingPolicy>(
      policy, support(), lambda_, std::move(strategy),
      control::SwitchingPolicyOptions{.horizon = options.horizon != 0 ? options.horizon : horizon_,
                                      .first_step = options.first_step});
}

}  // namespace dfr::safety
