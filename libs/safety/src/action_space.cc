#include "dfr/safety/action_space.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "dfr/core/contract.h"
#include "dfr/core/folds.h"
#include "dfr/core/format.h"
#include "dfr/safety/constants.h"

namespace dfr::safety {
namespace {

// Limits of values in files.
constexpr int kMostEntries = 1 << 16;

std::vector<int> SteeredOf(const std::vector<ActionEntry>& entries) {
  std::vector<int> steered;
  for (std::size_t i = 0; i < entries.size(); ++i) {
    if (entries[i].steered) steered.push_back(static_cast<int>(i));
  }
  return steered;
}

}  // namespace

ActionSpace::ActionSpace(std::span<const core::Trajectory> demonstrations) {
  DFR_THROW_UNLESS(!demonstrations.empty(), "there are no demonstrations");
  const Eigen::Index dim = demonstrations[0].controls.cols();
  entries_.resize(static_cast<std::size_t>(dim));
  // The order of the sum must not depend on the order of the demonstrations.
  const std::vector<core::Trajectory> ordered = core::InDeterministicOrder(demonstrations);
  double moving = 0.0;
  std::vector<double> squares(entries_.size(), 0.0);
  std::vector<std::set<double>> values(entries_.size());
  std::size_t transitions = 0;
  for (const core::Trajectory& demonstration : ordered) {
    for (Eigen::Index t = 0; t < demonstration.controls.rows(); ++t, ++transitions) {
      const auto u = demonstration.controls.row(t);
      moving += u.squaredNorm() > 0.0 ? 1.0 : 0.0;
      for (std::size_t i = 0; i < entries_.size(); ++i) {
        const double value = u[static_cast<Eigen::Index>(i)];
        squares[i] += value * value;
        if (values[i].size() <= fit::kMostFew) values[i].insert(value);
        entries_[i].largest = std::max(entries_[i].largest, std::abs(value));
      }
    }
  }
  const auto moves = [&](std::size_t i) { return squares[i] > 0.0; };
  DFR_THROW_UNLESS(moving > 0.0, "all actions of all "
                                     << demonstrations.size()
                                     << " demonstrations are zero: record the velocities or "
                                        "increments that moved the robot");
  for (std::size_t i = 0; i < entries_.size(); ++i) {
    entries_[i].steered = moves(i) && (values[i].size() > fit::kMostFew ||
                                       transitions < fit::kLeastRepeated * values[i].size());
  }
  // If every moving entry has few values, steers with these.
  const bool none = SteeredOf(entries_).empty();
  for (std::size_t i = 0; i < entries_.size() && none; ++i) entries_[i].steered = moves(i);
  steered_ = SteeredOf(entries_);
  for (const int i : steered_) {
    const auto k = static_cast<std::size_t>(i);
    entries_[k].unit = std::sqrt(squares[k] / moving * static_cast<double>(steered_.size()));
  }
}

void ActionSpace::Save(core::ArchiveWriter& archive) const {
  archive.Integer(dim());
  for (const ActionEntry& entry : entries_) {
    archive.Integer(entry.steered ? 1 : 0);
    archive.Number(entry.largest);
    archive.Number(entry.unit);
  }
}

ActionSpace ActionSpace::Load(core::ArchiveReader& archive) {
  ActionSpace space;
  space.entries_.resize(static_cast<std::size_t>(archive.IntegerIn(1, kMostEntries)));
  for (ActionEntry& entry : space.entries_) {
    entry.steered = archive.IntegerIn(0, 1) == 1;
    entry.largest = archive.Number();
    entry.unit = archive.Number();
    if (!(entry.largest >= 0.0 && std::isfinite(entry.largest) && entry.unit > 0.0 &&
          std::isfinite(entry.unit))) {
      archive.Fail("the range of an entry of an action must not be negative, its unit positive");
    }
  }
  space.steered_ = SteeredOf(space.entries_);
  if (space.steered_.empty()) archive.Fail("no entry of an action is steered");
  return space;
}

std::vector<double> ActionSpace::Limits(double factor) const {
  std::vector<double> limits;
  limits.reserve(entries_.size());
  for (const ActionEntry& entry : entries_) limits.push_back(factor * entry.largest);
  return limits;
}

std::vector<double> ActionSpace::MeasuredLimits(std::span<const double> limits) const {
  std::vector<double> measured(steered_.size());
  Measure(limits, measured);
  return measured;
}

std::vector<core::Trajectory> ActionSpace::Measured(
    std::span<const core::Trajectory> demonstrations) const {
  std::vector<core::Trajectory> measured(demonstrations.begin(), demonstrations.end());
  for (core::Trajectory& demonstration : measured) {
    core::Matrix a(demonstration.controls.rows(), steered_dim());
    for (Eigen::Index t = 0; t < a.rows(); ++t) {
      Measure({demonstration.controls.row(t).data(), entries_.size()},
              {a.row(t).data(), steered_.size()});
    }
    demonstration.controls = std::move(a);
  }
  return measured;
}

std::string Join(std::span<const double> values) {
  std::string joined;
  for (const double value : values) {
    joined += (joined.empty() ? "" : ", ") + core::Format("%g", value);
  }
  return joined;
}

void ActionSpace::Measure(std::span<const double> u, std::span<double> a) const noexcept {
  for (std::size_t k = 0; k < steered_.size(); ++k) {
    const auto i = static_cast<std::size_t>(steered_[k]);
    a[k] = u[i] / entries_[i].unit;
  }
}

void ActionSpace::Restore(std::span<const double> a, std::span<double> u) const noexcept {
  for (std::size_t k = 0; k < steered_.size(); ++k) {
    const auto i = static_cast<std::size_t>(steered_[k]);
    u[i] = a[k] * entries_[i].unit;
  }
}

double ActionSpace::Distance(std::span<const double> u,
                             std::span<const double> other) const noexcept {
  double square = 0.0;
  for (const int k : steered_) {
    const auto i = static_cast<std::size_t>(k);
    const double difference = (u[i] - other[i]) / entries_[i].unit;
    square += difference * difference;
  }
  return std::sqrt(square);
}

double ActionSpace::StepOf(std::span<const double> u) const noexcept {
  double square = 0.0;
  for (const int k : steered_) {
    const auto i = static_cast<std::size_t>(k);
    square += u[i] / entries_[i].unit * (u[i] / entries_[i].unit);
  }
  return std::min(1.0, std::sqrt(square));
}

}  // namespace dfr::safety
