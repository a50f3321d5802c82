#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "dfr/core/files/archive.h"
#include "dfr/safety/guard_model.h"

namespace dfr::safety {
namespace {

constexpr std::string_view kGuardKind = "guard";
constexpr int kGuardVersion = 8;
constexpr int kMostCount = 1 << 30;
constexpr int kMaxFitWarnings = 1 << 16;
constexpr int kMostRows = 1 << 10;

void Write(core::ArchiveWriter& archive, const control::EstimatedConstant& constant) {
  archive.Number(constant.value);
  archive.Number(constant.confidence);
  archive.Number(constant.coverage);
  archive.Integer(constant.demonstrations);
}

control::EstimatedConstant ReadConstant(core::ArchiveReader& archive) {
  control::EstimatedConstant constant;
  constant.value = archive.Number();
  constant.confidence = archive.Number();
  constant.coverage = archive.Number();
  constant.demonstrations = archive.IntegerIn(0, 1 << 30);
  return constant;
}

void Write(core::ArchiveWriter& archive, const reduction::ComponentsScore& row) {
  archive.Integer(row.components);
  for (const double value :
       {row.inside, row.explained, row.explained_error, row.action_error, row.response_error}) {
    archive.Number(value);
  }
}

reduction::ComponentsScore ReadScore(core::ArchiveReader& archive) {
  reduction::ComponentsScore row;
  row.components = archive.IntegerIn(1, reduction::Reduction::kMaxComponents);
  row.inside = archive.Number();
  row.explained = archive.Number();
  row.explained_error = archive.Number();
  row.action_error = archive.Number();
  row.response_error = archive.Number();
  return row;
}

void Write(core::ArchiveWriter& archive, const std::vector<SensorGroup>& groups) {
  archive.Integer(std::ssize(groups));
  for (const SensorGroup& group : groups) {
    archive.Integer(std::ssize(group.ranges));
    for (const SensorGroup::Range& range : group.ranges) {
      archive.Integer(range.first);
      archive.Integer(range.size);
    }
    archive.Number(group.longest);
  }
}

std::vector<SensorGroup> ReadGroups(core::ArchiveReader& archive, int state_dim) {
  std::vector<SensorGroup> groups(static_cast<std::size_t>(archive.IntegerIn(0, state_dim)));
  for (SensorGroup& group : groups) {
    group.ranges.resize(static_cast<std::size_t>(archive.IntegerIn(1, state_dim)));
    int end = 0;
    for (SensorGroup::Range& range : group.ranges) {
      range.first = archive.IntegerIn(end, state_dim - 1);
      range.size = archive.IntegerIn(1, state_dim - range.first);
      end = range.first + range.size;
    }
    group.longest = archive.Number();
    if (!(group.longest >= 0.0 && std::isfinite(group.longest))) {
      archive.Fail("has a longest standstill that is not a number of steps");
    }
  }
  return groups;
}

}  // namespace

void GuardModel::Save(const std::filesystem::path& path) const {
  core::ArchiveWriter archive(kGuardKind, kGuardVersion);
  archive.Integer(static_cast<std::int64_t>(layout().blocks.size()));
  for (const auto& block : layout().blocks) {
    archive.Text(block.name);
    archive.Integer(block.size);
    archive.Integers(std::array{block.picture.height, block.picture.width, block.picture.channels});
  }
  archive.Integer(reduction_ ? 1 : 0);
  if (reduction_) reduction_->Save(archive);
  archive.Text(task_->features().selection().spec());
  task_->features().selection().map().Save(archive);
  archive.Numbers(constants_);
  if (constant_entries_) {
    archive.Text(constant_entries_->spec());
    constant_entries_->map().Save(archive);
  }
  archive.Integer(context_ ? 1 : 0);
  if (context_) {
    archive.Text(context_->selection().spec());
    context_->selection().map().Save(archive);
    archive.Numbers(core::AsSpan(context_->offset()));
    const Eigen::VectorXd scale = context_->scale().diagonal();
    archive.Numbers(core::AsSpan(scale));
  }
  Write(archive, sensor_groups_);
  archive.Numbers(periods_);
  archive.Text(Name(settings_.strategy));
  archive.Integer(settings_.horizon);
  archive.Integer(settings_.max_actions);
  archive.Numbers(settings_.action_limit);
  archive.Number(settings_.alarm_level);
  archive.Number(settings_.direction_error);
  archive.Integer(settings_.demonstrated ? 1 : 0);
  archive.Text(summary_.source);
  archive.Text(summary_.version);
  archive.Integer(summary_.demonstrations);
  archive.Integer(summary_.transitions);
  for (const double value : {summary_.nu, summary_.gamma, summary_.acceptance,
                             summary_.inside_throughout, summary_.false_alarms}) {
    archive.Number(value);
  }
  archive.Number(summary_.confidence);
  archive.Integer(summary_.held_out);
  archive.Integer(summary_.support_fits);
  archive.Number(summary_.drift_level);
  archive.Number(summary_.drift_chance);
  for (const int count : {summary_.gaps.steps, summary_.gaps.points, summary_.gaps.inside}) {
    archive.Integer(count);
  }
  Write(archive, summary_.direction_error);
  Write(archive, summary_.gain);
  archive.Number(summary_.changed);
  archive.Number(summary_.ends_outside);
  archive.Number(summary_.explained);
  archive.Number(summary_.action_error);
  archive.Integer(std::ssize(summary_.components));
  for (const reduction::ComponentsScore& row : summary_.components) Write(archive, row);
  archive.Text(summary_.components_reason);
  archive.Integer(std::ssize(summary_.fit_warnings));
  for (const std::string& warning : summary_.fit_warnings) archive.Text(warning);
  actions_->Save(archive);
  task_->Save(archive);
  archive.Save(path);
}

std::shared_ptr<const GuardModel> GuardModel::Load(const std::filesystem::path& path) {
  core::ArchiveReader archive(path, kGuardKind, kGuardVersion);
  try {
    core::StateLayout layout;
    const int blocks = archive.IntegerIn(1, 1 << 16);
    for (int i = 0; i < blocks; ++i) {
      std::string name = archive.Text();
      const int size = archive.IntegerIn(1, core::StateLayout::kMaxStateDim);
      const std::vector<int> picture = archive.Integers();
      if (picture.size() != 3) archive.Fail("has a picture without a shape");
      if (picture == std::vector{0, 0, 0}) {
        layout.Add(std::move(name), size);
      } else {
        layout.Add(std::move(name), {picture[0], picture[1], picture[2]});
        if (layout.blocks.back().size != size) archive.Fail("has a picture of a different size");
      }
    }
    std::shared_ptr<const reduction::StateReduction> reduction;
    if (archive.IntegerIn(0, 1) == 1) {
      reduction = std::make_shared<const reduction::StateReduction>(
          reduction::StateReduction::Load(archive, layout));
      layout = reduction->reduced_layout();
    }
    const std::string spec = archive.Text();
    core::FeatureSelection selection =
        core::FeatureSelection::Of(layout, spec)
            .Mapped(core::StateMap::Load(archive, layout.state_dim()));
    std::vector<double> constants = archive.Numbers();
    std::optional<core::FeatureSelection> constant_entries;
    if (!constants.empty()) {
      constant_entries = core::FeatureSelection::Of(layout, archive.Text());
      constant_entries =
          constant_entries->Mapped(core::StateMap::Load(archive, layout.state_dim()));
      if (constants.size() != static_cast<std::size_t>(constant_entries->num_features())) {
        archive.Fail("does not have one value per constant entry");
      }
      if (!core::AllFinite(constants)) archive.Fail("has a constant that is not finite");
    }
    std::optional<core::FeatureTransform> context;
    if (archive.IntegerIn(0, 1) == 1) {
      core::FeatureSelection entries = core::FeatureSelection::Of(layout, archive.Text());
      entries = entries.Mapped(core::StateMap::Load(archive, layout.state_dim()));
      const std::vector<double> offset = archive.Numbers();
      const std::vector<double> scale = archive.Numbers();
      context.emplace(std::move(entries), core::AsVector(std::span(offset)),
                      core::Matrix(core::AsVector(std::span(scale)).asDiagonal()));
    }
    std::vector<SensorGroup> groups =
        ReadGroups(archive, reduction ? reduction->state_dim() : layout.state_dim());
    std::vector<double> periods = archive.Numbers();
    if (std::ssize(periods) != (reduction ? reduction->state_dim() : layout.state_dim()) ||
        !core::AllFinite(periods) ||
        std::ranges::any_of(periods, [](double period) { return period < 0.0; })) {
      archive.Fail("has periods of angles that do not match its states");
    }
    GuardSettings settings;
    settings.strategy = ParseStrategy(archive.Text());
    settings.horizon = archive.IntegerIn(1, kMostCount);
    settings.max_actions = archive.IntegerIn(1, kMostCount);
    settings.action_limit = archive.Numbers();
    settings.alarm_level = archive.Number();
    settings.direction_error = archive.Number();
    settings.demonstrated = archive.IntegerIn(0, 1) == 1;
    GuardSummary summary;
    summary.source = archive.Text();
    summary.version = archive.Text();
    summary.demonstrations = archive.IntegerIn(0, kMostCount);
    summary.transitions = archive.IntegerIn(0, kMostCount);
    summary.nu = archive.Number();
    summary.gamma = archive.Number();
    summary.acceptance = archive.Number();
    summary.inside_throughout = archive.Number();
    summary.false_alarms = archive.Number();
    summary.confidence = archive.Number();
    summary.held_out = archive.IntegerIn(0, kMostCount);
    summary.support_fits = archive.IntegerIn(0, kMostCount);
    summary.drift_level = archive.Number();
    summary.drift_chance = archive.Number();
    summary.gaps.steps = archive.IntegerIn(0, kMostCount);
    summary.gaps.points = archive.IntegerIn(0, kMostCount);
    summary.gaps.inside = archive.IntegerIn(0, kMostCount);
    summary.direction_error = ReadConstant(archive);
    summary.gain = ReadConstant(archive);
    summary.changed = archive.Number();
    summary.ends_outside = archive.Number();
    summary.explained = archive.Number();
    summary.action_error = archive.Number();
    const int rows = archive.IntegerIn(0, kMostRows);
    for (int i = 0; i < rows; ++i) summary.components.push_back(ReadScore(archive));
    summary.components_reason = archive.Text();
    const int count = archive.IntegerIn(0, kMaxFitWarnings);
    for (int i = 0; i < count; ++i) summary.fit_warnings.push_back(archive.Text());
    auto actions = std::make_shared<const ActionSpace>(ActionSpace::Load(archive));
    auto task = std::make_shared<const TaskModel>(TaskModel::Load(archive, std::move(selection)));
    archive.End();
    std::shared_ptr<GuardModel> model(new GuardModel);
    if (task->response().control_dim() != actions->steered_dim()) {
      archive.Fail("recovery steers a different number of action entries");
    }
    const int contexts = context ? context->num_features() : 0;
    if (task->response().prior()->context_dim() != contexts) {
      archive.Fail("recovery uses a different number of context entries");
    }
    model->context_ = std::move(context);
    model->reduction_ = std::move(reduction);
    model->Complete(std::move(layout), std::move(actions), std::move(task), settings);
    model->summary_ = std::move(summary);
    model->constant_entries_ = std::move(constant_entries);
    model->constants_ = std::move(constants);
    model->sensor_groups_ = std::move(groups);
    model->periods_ = std::move(periods);
    return model;
  } catch (const std::invalid_argument& e) {
    archive.Fail(e.what());
  }
}
}  // namespace dfr::safety
