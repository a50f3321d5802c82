#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "dfr/core/matrix.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"
#include "fit/recording_advice.h"

namespace dfr::safety::internal {
namespace {

// Returns 1 or -1 for an ordinary value of an entry of an action, which has a mean square of 1, and
// 0 for a small value.
int SideOf(double value) {
  constexpr double kLeast = 0.4;
  return value > kLeast ? 1 : value < -kLeast ? -1 : 0;
}

// Returns the side of each value if it lasts for `reach` values or more, and if within `reach`
// values the other side also lasts; otherwise 0.
std::vector<int> ChangingSides(std::span<const double> values, Eigen::Index reach) {
  const Eigen::Index n = std::ssize(values);
  Eigen::VectorXi lasting = Eigen::VectorXi::Zero(n);
  for (Eigen::Index begin = 0, i = 1; i <= n; ++i) {
    const int side = SideOf(values[static_cast<std::size_t>(begin)]);
    if (i < n && SideOf(values[static_cast<std::size_t>(i)]) == side) continue;
    if (i - begin >= reach) lasting.segment(begin, i - begin).setConstant(side);
    begin = i;
  }
  std::vector<int> sides;
  for (Eigen::Index i = 0; i < n; ++i) {
    const Eigen::Index first = std::max<Eigen::Index>(0, i - reach);
    const auto near = lasting.segment(first, std::min(n, i + reach + 1) - first);
    sides.push_back((near.array() == -lasting[i]).any() ? lasting[i] : 0);
  }
  return sides;
}

// Demonstrated transitions with actions that are not zero, sorted by time step.
struct Moves {
  core::Matrix points;
  std::vector<std::size_t> demonstration;
  Eigen::VectorXd values;                 // of one entry of an action, with a mean square of 1
  Eigen::VectorXi sides;                  // ChangingSides()
  std::vector<Eigen::Index> begin = {0};  // the first transition of a step; and the end

  [[nodiscard]] Eigen::Index num_steps() const { return std::ssize(begin) - 1; }
  // Returns the range of the transitions within `window` steps of t.
  [[nodiscard]] std::pair<Eigen::Index, Eigen::Index> Near(Eigen::Index t,
                                                           Eigen::Index window) const {
    const auto at = [&](Eigen::Index step) {
      return begin[static_cast<std::size_t>(std::clamp<Eigen::Index>(step, 0, num_steps()))];
    };
    return {at(t - window), at(t + window + 1)};
  }
};

// Returns the transitions of at most 200 demonstrations; none if ChangingSides() finds nothing.
Moves MovesOf(const GuardModel& model, std::span<const core::Trajectory> demonstrations,
              std::size_t entry, Eigen::Index window) {
  constexpr std::size_t kMost = 200;
  struct Move {
    Eigen::Index step;
    std::size_t demonstration;
    double value;
    int side;
  };
  std::vector<Move> moves;
  Moves sorted;
  // The unit is that of the whole action.
  const double unit = model.actions().entries()[entry].unit /
                      std::sqrt(static_cast<double>(model.actions().steered_dim()));
  bool changing = false;
  const std::size_t stride = (demonstrations.size() + kMost - 1) / kMost;
  for (std::size_t d = 0; d < demonstrations.size(); d += stride) {
    const core::Matrix& actions = demonstrations[d].controls;
    std::vector<double> values;
    const std::size_t first = moves.size();
    for (Eigen::Index t = 0; t < actions.rows(); ++t) {
      if (!(model.actions().StepOf(core::Row(actions, t)) > 0.0)) continue;
      values.push_back(actions(t, static_cast<Eigen::Index>(entry)) / unit);
      moves.push_back({t, d, values.back(), 0});
    }
    const std::vector<int> sides = ChangingSides(values, 2 * window);
    for (std::size_t i = 0; i < sides.size(); ++i) {
      moves[first + i].side = sides[i];
      changing = changing || sides[i] != 0;
    }
  }
  if (!changing) return sorted;
  std::ranges::stable_sort(moves, {}, &Move::step);
  const Eigen::Index n = std::ssize(moves);
  sorted.points.resize(n, model.task().features().num_features());
  sorted.values.resize(n);
  sorted.sides.resize(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Move& move = moves[static_cast<std::size_t>(i)];
    while (sorted.num_steps() < move.step) sorted.begin.push_back(i);
    model.task().features().Apply(core::Row(demonstrations[move.demonstration].states, move.step),
                                  core::Row(sorted.points, i));
    sorted.demonstration.push_back(move.demonstration);
    sorted.values[i] = move.value;
    sorted.sides[i] = move.side;
  }
  sorted.begin.push_back(n);
  return sorted;
}

// Returns the share on the smaller side among the transitions of other demonstrations, within
// `window` steps of t, that are nearest to transition i. Only changing sides count, and small
// values count against them: two modes have no values between them.
double OppositeShare(const Moves& moves, Eigen::Index i, Eigen::Index t, Eigen::Index window) {
  constexpr std::size_t kNearest = 15;
  std::vector<std::pair<double, Eigen::Index>> near;
  const auto [first, last] = moves.Near(t, window);
  for (Eigen::Index k = first; k < last; ++k) {
    if (moves.demonstration[static_cast<std::size_t>(k)] ==
        moves.demonstration[static_cast<std::size_t>(i)])
      continue;
    near.emplace_back((moves.points.row(k) - moves.points.row(i)).squaredNorm(), k);
  }
  if (near.size() < kNearest) return 0.0;
  std::nth_element(near.begin(), near.begin() + kNearest - 1, near.end());
  near.resize(kNearest);
  const auto count = [&](int side) {
    return std::ranges::count_if(near,
                                 [&](const auto& n) { return moves.sides[n.second] == side; });
  };
  const auto small = std::ranges::count_if(
      near, [&](const auto& n) { return SideOf(moves.values[n.second]) == 0; });
  return std::max(0.0, static_cast<double>(std::min(count(1), count(-1)) - small) / kNearest);
}

// Returns true if a regression on the features explains the sides within `window` steps of t, or if
// there are too few transitions to tell.
bool ExplainsSides(const Moves& moves, Eigen::Index t, Eigen::Index window) {
  constexpr double kMostLeft = 0.5;  // share of the variance
  constexpr Eigen::Index kRowsPerColumn = 3;
  const auto [first, last] = moves.Near(t, window);
  std::vector<Eigen::Index> rows;
  for (Eigen::Index k = first; k < last; ++k) {
    if (moves.sides[k] != 0) rows.push_back(k);
  }
  const Eigen::Index n = std::ssize(rows);
  const Eigen::Index columns = 1 + moves.points.cols();
  if (n < kRowsPerColumn * columns) return true;
  Eigen::MatrixXd x = Eigen::MatrixXd::Ones(n, columns);
  x.rightCols(columns - 1) = moves.points(rows, Eigen::all);
  const Eigen::MatrixXd y = moves.sides(rows).cast<double>();
  const double left =
      (y - x * core::SolveLeastSquares(x, y)).squaredNorm() / static_cast<double>(n - columns);
  return left <= kMostLeft * (y.array() - y.mean()).square().sum() / static_cast<double>(n - 1);
}

}  // namespace

std::string DescribeOpposites(const GuardModel& model,
                              std::span<const core::Trajectory> demonstrations) {
  constexpr Eigen::Index kSamples = 1500;
  constexpr double kFewestSamples = 20.0;
  constexpr double kLeastShare = 0.055;
  const Eigen::Index window = model.task().response().prior()->options().window;
  double worst = kLeastShare;
  std::string description;
  for (std::size_t entry = 0; entry < model.actions().entries().size(); ++entry) {
    if (!model.actions().entries()[entry].steered) continue;
    const Moves moves = MovesOf(model, demonstrations, entry, window);
    const Eigen::Index steps = moves.num_steps();
    const Eigen::Index stride = std::max<Eigen::Index>(1, moves.points.rows() / kSamples);
    Eigen::VectorXd sums = Eigen::VectorXd::Zero(steps);
    Eigen::VectorXd counts = sums;
    for (Eigen::Index t = 0; t < steps; ++t) {
      const auto [first, last] = moves.Near(t, 0);
      for (Eigen::Index i = first; i < last; ++i) {
        if (i % stride != 0) continue;
        sums[t] += OppositeShare(moves, i, t, window);
        counts[t] += 1.0;
      }
    }
    Eigen::Index middle = -1;
    for (Eigen::Index t = 0; t < steps; ++t) {
      const Eigen::Index first = std::max<Eigen::Index>(0, t - 2 * window);
      const Eigen::Index size = std::min(steps, t + 2 * window + 1) - first;
      const double count = counts.segment(first, size).sum();
      const double share = sums.segment(first, size).sum() / std::max(1.0, count);
      if (count < kFewestSamples || share <= worst || ExplainsSides(moves, t, 2 * window)) continue;
      worst = share;
      middle = t;
    }
    if (middle < 0) continue;
    // The steps near the middle at which the share is large.
    Eigen::Index begin = middle;
    Eigen::Index end = middle;
    for (Eigen::Index t = std::max<Eigen::Index>(0, middle - 2 * window);
         t < std::min(steps, middle + 2 * window + 1); ++t) {
      if (sums[t] < worst * counts[t] || counts[t] == 0.0) continue;
      begin = std::min(begin, t);
      end = std::max(end, t);
    }
    const double share = sums.segment(begin, end - begin + 1).sum() /
                         std::max(1.0, counts.segment(begin, end - begin + 1).sum());
    description = core::Format(
        "near steps %d to %d demonstrations act oppositely in entry %zu of an action at the same "
        "place (%.0f %%): add the entry that decides to the features, for example a gear or a "
        "flag, with its value before the action",
        static_cast<int>(begin), static_cast<int>(end), entry, 100.0 * share);
  }
  return description;
}

}  // namespace dfr::safety::internal
