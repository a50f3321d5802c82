#include "dfr/safety/task_model.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/kernel/one_class_svm.h"
#include "fit/fit_task.h"

namespace dfr::safety {
namespace {

constexpr std::string_view kTaskKind = "task-model";
constexpr int kTaskVersion = 5;
constexpr std::string_view kTaskFile = "task.dfr";
constexpr std::string_view kSupportFile = "support.dfr";
constexpr int kMostHorizon = 1'000'000;
// Limit that no task reaches. A file with a larger count is damaged.
constexpr int kMostSteps = 1'000'000;
constexpr double kRounding = 1e-9;

kernel::WhitenedSupport LoadSupport(core::ArchiveReader& archive, bool single_precision) {
  const int steps = archive.IntegerIn(1, kMostSteps);
  std::vector<kernel::WhitenedSupport::Estimate> estimates;
  for (int t = 0; t < steps; ++t) {
    core::Matrix map = archive.MatrixBlock();
    const double gamma = archive.Number();
    const double rho = archive.Number();
    // With rho <= 0, every state would be inside. A sum of kernels whose weights sum to 1 is at
    // most 1.
    if (!(rho > 0.0 && rho <= 1.0 + kRounding)) archive.Fail("rho must lie in (0, 1]");
    const double scale = archive.Number();
    const std::vector<double> alpha = archive.Numbers();
    auto svm = kernel::OneClassSvm::FromParts(archive.MatrixBlock(), core::AsVector(alpha), gamma,
                                              rho, scale);
    estimates.push_back({std::move(map), single_precision ? svm.InSinglePrecision() : svm});
  }
  return kernel::WhitenedSupport(std::move(estimates));
}

void SaveSupport(core::ArchiveWriter& archive, const kernel::WhitenedSupport& support) {
  archive.Integer(support.num_steps());
  for (int t = 0; t < support.num_steps(); ++t) {
    const kernel::OneClassSvm& svm = support.estimate(t);
    archive.MatrixBlock(support.map(t));
    archive.Number(svm.gamma());
    archive.Number(svm.rho());
    archive.Number(svm.libsvm_scale());
    archive.Numbers(core::AsSpan(svm.alpha()));
    archive.MatrixBlock(svm.support_vectors());
  }
}

TaskParts LoadParts(core::ArchiveReader& archive, core::FeatureSelection selection) {
  std::vector<double> lambda = archive.Numbers();
  const std::vector<double> offset = archive.Numbers();
  core::FeatureTransform features(std::move(selection), core::AsVector(offset),
                                  archive.MatrixBlock());
  const bool single_precision = archive.IntegerIn(0, 1) == 1;
  kernel::WhitenedSupport support = LoadSupport(archive, single_precision);
  control::Levels levels = control::Levels::Load(archive);
  return {.features = std::move(features),
          .support = std::move(support),
          .levels = std::move(levels),
          .response = control::Response::Load(archive),
          .lambda = std::move(lambda),
          .single_precision = single_precision};
}

}  // namespace

core::FeatureDecision TaskParts::PublishedDecision() const {
  if (!published) return GuidedDecision();
  return {core::FeatureTransform::Identity(published->features), published->support};
}

struct TaskModel::Data {
  explicit Data(TaskParts made)
      : parts(std::move(made)),
        guided(parts.GuidedDecision()),
        published(parts.PublishedDecision()) {}
  Data(const Data&) = delete;
  Data& operator=(const Data&) = delete;

  TaskParts parts;
  core::FeatureDecision guided;
  core::FeatureDecision published;
};

TaskModel::TaskModel(const core::StateLayout& layout,
                     std::span<const core::Trajectory> demonstrations, const TaskOptions& options)
    : TaskModel(internal::FitTask(layout, demonstrations, options)) {}

TaskModel::TaskModel(TaskParts parts) : data_(std::make_unique<const Data>(std::move(parts))) {
  DFR_THROW_UNLESS(horizon() > 0 && horizon() <= kMostHorizon,
                   "horizon must lie in [1, " << kMostHorizon << "], not " << horizon());
  DFR_THROW_UNLESS(
      !lambda().empty() && std::all_of(lambda().begin(), lambda().end(),
                                       [](double l) { return l > 0.0 && std::isfinite(l); }),
      "lambda must be positive and finite");
  control::CheckFits(view());
  DFR_THROW_UNLESS(support().state_dim() == guided_support().state_dim(),
                   "the published support takes states of "
                       << support().state_dim() << " entries, but guided recovery's takes "
                       << guided_support().state_dim());
}

TaskModel::TaskModel(TaskModel&&) noexcept = default;
TaskModel& TaskModel::operator=(TaskModel&&) noexcept = default;
TaskModel::~TaskModel() = default;

const core::DecisionFunction& TaskModel::support() const noexcept {
  return data_->parts.published ? data_->published : data_->guided;
}
const core::LogDecisionFunction& TaskModel::guided_support() const noexcept {
  return data_->guided;
}
const core::FeatureTransform& TaskModel::features() const noexcept { return data_->parts.features; }
const kernel::WhitenedSupport& TaskModel::feature_support() const noexcept {
  return data_->parts.support;
}
const control::Levels& TaskModel::levels() const noexcept { return data_->parts.levels; }
const control::Response& TaskModel::response() const noexcept { return data_->parts.response; }
control::TaskView TaskModel::view() const noexcept { return data_->parts.view(); }
bool TaskModel::single_precision() const noexcept { return data_->parts.single_precision; }
const kernel::TimeVaryingSupport* TaskModel::published() const noexcept {
  return data_->parts.published ? &data_->parts.published->support : nullptr;
}
const std::string& TaskModel::published_features() const noexcept {
  static const std::string kNone;
  return data_->parts.published ? data_->parts.published->features.spec() : kNone;
}
const std::vector<double>& TaskModel::lambda() const noexcept { return data_->parts.lambda; }
int TaskModel::horizon() const noexcept { return data_->parts.horizon; }

void TaskModel::Save(const std::filesystem::path& folder) const {
  const auto maps = [](const core::FeatureSelection& selection) {
    return !selection.map().empty();
  };
  if (maps(features().selection()) || (published() && maps(data_->parts.published->features))) {
    throw std::runtime_error((folder / kTaskFile).string() +
                             ": the file cannot hold the map of rotations and angles of this "
                             "model; save a guard model instead");
  }
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) {
    throw std::runtime_error(folder.string() +
                             ": the folder cannot be created: " + error.message());
  }
  if (published() != nullptr) published()->Save(folder / kSupportFile);
  core::ArchiveWriter archive(kTaskKind, kTaskVersion);
  archive.Integer(published() != nullptr ? 1 : 0);
  archive.Text(published_features());
  archive.Text(features().selection().spec());
  archive.Integer(horizon());
  Save(archive);
  archive.Save(folder / kTaskFile);
}

void TaskModel::Save(core::ArchiveWriter& archive) const {
  archive.Numbers(lambda());
  archive.Numbers(core::AsSpan(features().offset()));
  archive.MatrixBlock(features().scale());
  archive.Integer(single_precision() ? 1 : 0);
  SaveSupport(archive, feature_support());
  levels().Save(archive);
  response().Save(archive);
}

TaskModel TaskModel::Load(const std::filesystem::path& folder, const core::StateLayout& layout) {
  core::ArchiveReader archive(folder / kTaskFile, kTaskKind, kTaskVersion);
  const bool published = archive.IntegerIn(0, 1) == 1;
  try {
    const std::string published_features = archive.Text();
    const std::string guided_features = archive.Text();
    const int horizon = archive.IntegerIn(1, kMostHorizon);
    TaskParts parts = LoadParts(archive, core::FeatureSelection::Of(layout, guided_features));
    archive.End();
    parts.horizon = horizon;
    if (published) {
      parts.published = PublishedSupport{core::FeatureSelection::Of(layout, published_features),
                                         kernel::TimeVaryingSupport::Load(folder / kSupportFile)};
    }
    return TaskModel(std::move(parts));
  } catch (const std::invalid_argument& e) {
    archive.Fail(std::string("does not fit the other files of this model: ") + e.what());
  }
}

TaskModel TaskModel::Load(core::ArchiveReader& archive, core::FeatureSelection selection) {
  try {
    return TaskModel(LoadParts(archive, std::move(selection)));
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}

std::unique_ptr<control::Controller> TaskModel::MakeController(
    const Method& method, const core::Policy& policy, const ControllerOptions& options) const {
  DFR_THROW_UNLESS(method.kind != Method::Kind::kOther,
                   "the method '" << method.name << "' belongs to the caller, not to a task model");
  if (method.kind == Method::Kind::kController || method.kind == Method::Kind::kGuard) {
    control::GuidedOptions guided = control::Without(options.guided, method.without);
    guided.horizon = options.horizon != 0 ? options.horizon : horizon();
    guided.first_step = options.first_step;
    guided.least_intervention = method.kind == Method::Kind::kGuard;
    return std::make_unique<control::GuidedController>(policy, view(), guided);
  }
  const control::SwitchingControllerOptions switching{
      .recovery = method.recovery,
      .horizon = options.horizon != 0 ? options.horizon : horizon(),
      .first_step = options.first_step,
      .dfr = method.published_dfr ? control::DfrOptions{} : options.dfr};
  return std::make_unique<control::SwitchingController>(policy, support(), lambda(), switching);
}

std::unique_ptr<control::Controller> TaskModel::MakeController(
    std::unique_ptr<control::RecoveryStrategy> strategy, const core::Policy& policy,
    const ControllerOptions& options) const {
  return std::make_unique<control::SwitchingController>(
      policy, support(), lambda(), std::move(strategy),
      control::SwitchingControllerOptions{
          .horizon = options.horizon != 0 ? options.horizon : horizon(),
          .first_step = options.first_step});
}

}  // namespace dfr::safety
