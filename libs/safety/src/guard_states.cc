// Maps from states to features and angles.
#include <algorithm>
#include <cmath>
#include <optional>

#include "dfr/core/contract.h"
#include "dfr/core/features/rotations.h"
#include "dfr/safety/constants.h"
#include "dfr/safety/guard_model.h"
#include "fit/left_out.h"

namespace dfr::safety {
namespace {

// A double this many periods from zero resolves 1e-10 of a period. No counter of revolutions
// reaches this value.
constexpr double kMostRevolutions = 1e6;

}  // namespace

template <typename Visit>
void GuardModel::EachAngle(const Visit& visit) const {
  const core::FeatureSelection* const constants = constant_entries_ ? &*constant_entries_ : nullptr;
  const core::FeatureSelection* const context = context_ ? &context_->selection() : nullptr;
  for (const core::FeatureSelection* part : {&task_->features().selection(), constants, context}) {
    if (part == nullptr) continue;
    for (const auto& angle : part->map().angles()) visit(angle.entry, angle.period);
    for (const auto& circle : part->map().circles()) visit(circle.entry, circle.period);
  }
}

int GuardModel::FindImmeasurableAngle(std::span<const double> task_state) const noexcept {
  int found = -1;
  EachAngle([&](int entry, double period) {
    const double value = task_state[static_cast<std::size_t>(entry)];
    const bool measurable = std::abs(value) <= kMostRevolutions * period;
    if (!measurable && (found < 0 || entry < found)) found = entry;
  });
  return found;
}

std::vector<double> GuardModel::FindPeriods(
    const core::StateLayout& recorded, std::span<const core::Trajectory> demonstrations) const {
  std::vector<double> periods(static_cast<std::size_t>(state_dim()), 0.0);
  core::StateLayout plain;
  std::vector<int> entries;
  for (const auto& block : recorded.blocks) {
    if (block.picture.height > 0) continue;
    plain.Add(block.name, block.size);
    for (int i = 0; i < block.size; ++i) entries.push_back(block.offset + i);
  }
  std::vector<core::Trajectory> beside(demonstrations.size());
  for (std::size_t d = 0; d < beside.size(); ++d) {
    beside[d].states = demonstrations[d].states(Eigen::all, entries);
    beside[d].controls = demonstrations[d].controls;
  }
  for (const core::Rotation& r : core::FindRotations(plain, beside)) {
    if (r.kind != core::Rotation::Kind::kAngle) continue;
    const int entry = entries[static_cast<std::size_t>(r.first)];
    periods[static_cast<std::size_t>(entry)] = r.period;
  }
  EachAngle([&](int entry, double period) {
    const auto& own = *std::ranges::find_if(
        layout_.blocks, [&](const auto& b) { return entry < b.offset + b.size; });
    const auto& blocks = layout().blocks;
    const auto whole = std::ranges::find(blocks, own.name, &core::StateLayout::Block::name);
    if (whole == blocks.end()) return;  // Part of a reduced block.
    periods[static_cast<std::size_t>(whole->offset + entry - own.offset)] = period;
  });
  return periods;
}

int GuardModel::FindChangedConstant(std::span<const double> task_state,
                                    std::span<double> values) const noexcept {
  if (!constant_entries_) return -1;
  if (task_->features().selection().map().FindInvalid(task_state) >= 0) return -1;
  constant_entries_->Apply(task_state, values);
  for (std::size_t i = 0; i < values.size(); ++i) {
    if (!(std::abs(values[i] - constants_[i]) <=
          fit::kConstantTolerance * std::max(1.0, std::abs(constants_[i])))) {
      return constant_entries_->indices()[i];
    }
  }
  return -1;
}

std::vector<double> GuardModel::Levels(const core::Matrix& states, std::vector<int>* steps) const {
  DFR_THROW_UNLESS(
      states.cols() == state_dim(),
      "states have " << states.cols() << " entries, but the guard's states have " << state_dim());
  return internal::Follow(support(), reduction_ ? TaskStates(states) : states, steps);
}

core::Matrix GuardModel::TaskStates(const core::Matrix& states) const {
  DFR_THROW_UNLESS(
      states.cols() == state_dim(),
      "states have " << states.cols() << " entries, but the guard's states have " << state_dim());
  if (!reduction_) return states;
  reduction::StateReduction::Workspace workspace(*reduction_);
  core::Matrix reduced(states.rows(), layout_.state_dim());
  for (Eigen::Index i = 0; i < states.rows(); ++i) {
    reduction_->Apply(core::Row(states, i), workspace);
    reduced.row(i) = core::AsVector(workspace.state()).transpose();
  }
  return reduced;
}

Eigen::VectorXd GuardModel::Features(std::span<const double> state) const {
  DFR_THROW_UNLESS(
      static_cast<int>(state.size()) == state_dim(),
      "the state has " << state.size() << " entries, but the guard's states have " << state_dim());
  const core::FeatureTransform& features = task_->features();
  Eigen::VectorXd z(features.num_features());
  if (reduction_) {
    reduction::StateReduction::Workspace workspace(*reduction_);
    reduction_->Apply(state, workspace);
    features.Apply(workspace.state(), core::AsSpan(z));
  } else {
    features.Apply(state, core::AsSpan(z));
  }
  return z;
}

}  // namespace dfr::safety
