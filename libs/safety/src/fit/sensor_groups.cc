#include "fit/sensor_groups.h"

#include <algorithm>
#include <cmath>

#include "dfr/core/features/features.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/safety/constants.h"
#include "fit/choose_features.h"

namespace dfr::safety::internal {
namespace {

// Actions explain an entry if they leave less than this fraction of its changes unexplained.
constexpr double kLeastUnexplained = 0.05;

// Returns the fraction of an entry's squared changes that a linear function of the actions leaves
// unexplained. At zero, the robot alone causes the motion.
double ChangesLeftByActions(std::span<const core::Trajectory> demonstrations, Eigen::Index entry) {
  const Eigen::Index dim = demonstrations[0].controls.cols();
  Eigen::MatrixXd squares = Eigen::MatrixXd::Zero(dim, dim);
  Eigen::VectorXd sum = Eigen::VectorXd::Zero(dim);
  double all = 0.0;
  for (const core::Trajectory& d : demonstrations) {
    const Eigen::VectorXd x = d.states.col(entry);
    const Eigen::VectorXd change = x.tail(d.controls.rows()) - x.head(d.controls.rows());
    squares.noalias() += d.controls.transpose() * d.controls;
    sum.noalias() += d.controls.transpose() * change;
    all += change.squaredNorm();
  }
  return all > 0.0 ? 1.0 - sum.dot(core::PseudoInverse(squares) * sum) / all : 0.0;
}

// The blocks of the state that contain some of `entries`, without jumps.
struct SteadyBlocks {
  SteadyBlocks(const core::StateLayout& whole, const std::vector<int>& entries,
               std::span<const core::Trajectory> recorded) {
    core::StateLayout layout;
    for (const auto& block : whole.blocks) {
      if (std::ranges::none_of(entries, [&](int entry) {
            return entry >= block.offset && entry < block.offset + block.size;
          })) {
        continue;
      }
      layout.Add(block.name, block.size);
      for (int i = 0; i < block.size; ++i) columns.push_back(block.offset + i);
    }
    for (const core::Trajectory& d : recorded) {
      core::Trajectory& part = demonstrations.emplace_back();
      part.states = d.states(Eigen::all, columns);
      part.controls = d.controls;
    }
    if (!columns.empty()) demonstrations = WithoutJumps(layout, demonstrations);
  }
  [[nodiscard]] Eigen::Index ColumnOf(int entry) const {
    return std::ranges::lower_bound(columns, entry) - columns.begin();
  }

  std::vector<int> columns;  // Ascending entries of the whole state.
  std::vector<core::Trajectory> demonstrations;
};

bool StandsStill(const SensorGroup& group, const core::Matrix& states, Eigen::Index t) {
  return std::ranges::all_of(group.ranges, [&](const SensorGroup::Range& range) {
    return states.row(t).segment(range.first, range.size) ==
           states.row(t + 1).segment(range.first, range.size);
  });
}

}  // namespace

bool FollowsClock(std::span<const core::Trajectory> demonstrations, Eigen::Index entry) {
  constexpr double kMostWithin = 1e-6;
  Eigen::Index longest = 0;
  for (const auto& d : demonstrations) longest = std::max(longest, d.states.rows());
  double count = 0.0;
  double sum = 0.0;
  double squares = 0.0;
  double within = 0.0;
  const double origin = demonstrations[0].states(0, entry);
  for (Eigen::Index t = 0; t < longest; ++t) {
    double here = 0.0;
    double sum_here = 0.0;
    double squares_here = 0.0;
    for (const auto& d : demonstrations) {
      if (t >= d.states.rows()) continue;
      const double x = d.states(t, entry) - origin;
      here += 1.0;
      sum_here += x;
      squares_here += x * x;
    }
    if (here < 2.0) continue;
    count += here;
    sum += sum_here;
    squares += squares_here;
    within += squares_here - sum_here * sum_here / here;
  }
  const double total = count > 0.0 ? squares - sum * sum / count : 0.0;
  return total > 0.0 && within <= kMostWithin * total;
}

bool MovedByActions(std::span<const core::Trajectory> demonstrations, Eigen::Index entry) {
  return ChangesLeftByActions(demonstrations, entry) < kLeastUnexplained;
}

bool AdvancesUniformly(std::span<const core::Trajectory> demonstrations, Eigen::Index entry) {
  // Relative difference up to which rates, or distances, count as equal.
  constexpr double kSame = 1e-2;
  constexpr double kRounding = 1e-28;
  double values = 0.0;
  double squares = 0.0;
  double missed = 0.0;
  double low[2] = {};
  double high[2] = {};
  for (std::size_t d = 0; d < demonstrations.size(); ++d) {
    const Eigen::VectorXd x = demonstrations[d].states.col(entry);
    const auto steps = static_cast<double>(x.size() - 1);
    const Eigen::VectorXd t = Eigen::VectorXd::LinSpaced(x.size(), -0.5 * steps, 0.5 * steps);
    const Eigen::VectorXd moved = x.array() - x.mean();
    const double rate = t.dot(moved) / t.squaredNorm();
    values += x.squaredNorm();
    squares += moved.squaredNorm();
    missed += (moved - rate * t).squaredNorm();
    const double paces[2] = {rate, rate * steps};
    for (std::size_t i = 0; i < 2; ++i) {
      low[i] = d == 0 ? paces[i] : std::min(low[i], paces[i]);
      high[i] = d == 0 ? paces[i] : std::max(high[i], paces[i]);
    }
  }
  if (squares <= kRounding * values || missed > fit::kClockError * squares) return false;
  for (std::size_t i = 0; i < 2; ++i) {
    if (high[i] - low[i] <= kSame * std::max(std::abs(low[i]), std::abs(high[i]))) {
      return !MovedByActions(demonstrations, entry);
    }
  }
  return false;
}

std::vector<SensorGroup> FitSensorGroups(const GuardModel& model,
                                         std::span<const core::Trajectory> demonstrations) {
  using Block = core::StateLayout::Block;
  std::vector<SensorGroup> groups;
  std::vector<int> others;
  for (const int entry : model.task().features().selection().indices()) {
    const Block& block = *std::ranges::find_if(
        model.task_layout().blocks, [&](const Block& b) { return entry < b.offset + b.size; });
    std::string_view name = block.name;
    if (model.reduction() != nullptr) name.remove_prefix(core::ReductionPrefix(name).size());
    const Block& source = *std::ranges::find(model.layout().blocks, name, &Block::name);
    if (name.size() == block.name.size() && source.picture.height == 0) {
      others.push_back(source.offset + entry - block.offset);
    } else if (groups.empty() || groups.back().ranges[0].first != source.offset) {
      groups.push_back({.ranges = {{source.offset, source.size}}});
    }
  }
  std::ranges::sort(others);
  others.erase(std::unique(others.begin(), others.end()), others.end());
  // Excludes entries that advance with time, because they change even while a sensor is frozen.
  const SteadyBlocks steady(model.layout(), others, demonstrations);
  std::erase_if(others, [&](int entry) {
    const Eigen::Index column = steady.ColumnOf(entry);
    return AdvancesUniformly(steady.demonstrations, column) ||
           (FollowsClock(steady.demonstrations, column) &&
            !MovedByActions(steady.demonstrations, column));
  });
  SensorGroup rest;
  for (const int entry : others) {
    if (rest.ranges.empty() || entry > rest.ranges.back().first + rest.ranges.back().size) {
      rest.ranges.push_back({entry, 0});
    }
    rest.ranges.back().size = entry + 1 - rest.ranges.back().first;
  }
  if (!rest.ranges.empty()) groups.push_back(std::move(rest));
  for (SensorGroup& group : groups) {
    for (const core::Trajectory& d : demonstrations) {
      double steps = 0.0;
      for (Eigen::Index t = 0; t < d.controls.rows(); ++t) {
        const bool still = StandsStill(group, d.states, t);
        steps = still ? steps + model.actions().StepOf(core::Row(d.controls, t)) : 0.0;
        group.longest = std::max(group.longest, steps);
      }
    }
  }
  return groups;
}

}  // namespace dfr::safety::internal
