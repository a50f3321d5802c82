#include "fit/recording_advice.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "dfr/core/features/absolute_actions.h"
#include "dfr/core/features/state_map.h"
#include "dfr/core/matrix.h"
#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"
#include "dfr/safety/constants.h"
#include "fit/choose_features.h"
#include "fit/sensor_groups.h"

namespace dfr::safety::internal {
namespace {

// The largest absolute value in a column of one of the matrices, and the largest in all others.
struct Largest {
  std::size_t demonstration = 0;
  Eigen::Index step = 0;
  double value = 0.0;
  double others = 0.0;
};

Largest LargestOf(std::span<const core::Matrix> matrices, Eigen::Index column) {
  Largest largest;
  for (std::size_t d = 0; d < matrices.size(); ++d) {
    if (matrices[d].rows() == 0) continue;
    Eigen::Index t = 0;
    const double value = matrices[d].col(column).cwiseAbs().maxCoeff(&t);
    if (value > largest.value) {
      largest = {d, t, value, largest.value};
    } else {
      largest.others = std::max(largest.others, value);
    }
  }
  return largest;
}

// Returns true if the value of an entry may jump although the robot does not.
bool IsRotation(const core::StateMap& map, int entry) {
  return map.FindCircle(entry) != nullptr ||
         std::ranges::any_of(map.angles(),
                             [&](const auto& angle) { return angle.entry == entry; }) ||
         std::ranges::any_of(map.quaternions(), [&](const auto& quaternion) {
           return entry >= quaternion.first && entry < quaternion.first + 4;
         });
}

bool Equal(const core::Matrix& a, const core::Matrix& b) {
  return a.rows() == b.rows() && a.cols() == b.cols() && a == b;
}

// Returns the residuals of each column of y after a linear regression on the columns of x.
Eigen::VectorXd Residuals(const Eigen::MatrixXd& x, const Eigen::MatrixXd& y) {
  return (y - x * core::SolveLeastSquares(x, y)).colwise().squaredNorm();
}

}  // namespace

std::string DescribeCopies(std::span<const core::Trajectory> demonstrations) {
  int copies = 0;
  std::string pair;
  for (std::size_t d = 1; d < demonstrations.size(); ++d) {
    const core::Trajectory& copy = demonstrations[d];
    const auto original =
        std::ranges::find_if(demonstrations.first(d), [&](const core::Trajectory& other) {
          return Equal(copy.states, other.states) && Equal(copy.controls, other.controls);
        });
    if (original == demonstrations.begin() + static_cast<std::ptrdiff_t>(d)) continue;
    if (++copies > 1) continue;
    pair = core::Format("demonstration %zu repeats demonstration %td", d,
                        original - demonstrations.begin());
  }
  if (copies == 0) return "";
  return pair + (copies > 1 ? core::Format(", and %d others are copies, too", copies - 1) : "") +
         ": a copy of a left-out demonstration remains in the fit. The shares of left-out "
         "demonstrations are then too good, and alarms are too frequent. Leave copies out";
}

std::string DescribeRest(const GuardModel& model,
                         std::span<const core::Trajectory> demonstrations) {
  constexpr Eigen::Index kLeastRest = 5;
  constexpr double kStill = 0.1;     // change of an entry, relative to its root mean square
  constexpr double kOrdinary = 0.5;  // size of an action, relative to an ordinary one
  constexpr int kFewestSteps = 20;
  constexpr int kFewestEpisodes = 3;
  const Eigen::Index dim = demonstrations[0].states.cols();
  std::vector<core::Matrix> changes;
  Eigen::RowVectorXd sums = Eigen::RowVectorXd::Zero(dim);
  Eigen::RowVectorXd squares = sums;
  double count = 0.0;
  for (const core::Trajectory& d : demonstrations) {
    const Eigen::Index n = d.controls.rows();
    changes.emplace_back(d.states.middleRows(1, n) - d.states.topRows(n));
    sums += changes.back().colwise().sum();
    squares += changes.back().colwise().squaredNorm();
    count += static_cast<double>(n);
  }
  Eigen::RowVectorXd limits = kStill * (squares / count).cwiseSqrt();
  for (Eigen::Index i = 0; i < dim; ++i) {
    const double mean = sums[i] / count;
    const bool uniform = squares[i] / count - mean * mean <= kStill * squares[i] / count;
    if (uniform && (FollowsClock(demonstrations, i) || !MovedByActions(demonstrations, i))) {
      limits[i] = HUGE_VAL;
    }
  }
  // If every entry advances by itself, no limit shows rest.
  if (!(limits.array() < HUGE_VAL).any()) return "";
  int at_rest = 0;
  int driven = 0;
  int episodes = 0;
  for (std::size_t i = 0; i < changes.size(); ++i) {
    const core::Matrix& actions = demonstrations[i].controls;
    const int before = driven;
    for (Eigen::Index begin = 0, t = 0; t <= actions.rows(); ++t) {
      if (t < actions.rows() && (changes[i].row(t).array().abs() <= limits.array()).all()) continue;
      for (const Eigen::Index end = t - begin < kLeastRest ? begin : t; begin < end; ++begin) {
        ++at_rest;
        if (model.actions().StepOf(core::Row(actions, begin)) >= kOrdinary) ++driven;
      }
      begin = t + 1;
    }
    episodes += driven > before ? 1 : 0;
  }
  if (driven < kFewestSteps || episodes < kFewestEpisodes || 2 * driven < at_rest) return "";
  return core::Format(
      "in %d of the %d steps in which the robot rests, its action is of ordinary size: the robot "
      "is "
      "blocked, or a zero action does not hold it, as with torques against gravity. In the second "
      "case use velocities or increments, because the guard halts with zero actions",
      driven, at_rest);
}

std::string DescribeDelay(const GuardModel& model,
                          std::span<const core::Trajectory> demonstrations) {
  constexpr Eigen::Index kMostLag = 3;
  constexpr Eigen::Index kSamples = 3000;
  constexpr Eigen::Index kRowsPerColumn = 5;
  constexpr double kDetermined = 1e-6;  // Negligible fraction of the squared changes.
  const Eigen::Index n = model.task().features().num_features();
  const Eigen::Index m = demonstrations[0].controls.cols();
  Eigen::Index transitions = 0;
  const auto count = [](const core::Trajectory& d) {
    return std::max<Eigen::Index>(0, d.controls.rows() - 1 - kMostLag);
  };
  for (const core::Trajectory& d : demonstrations) transitions += count(d);
  const Eigen::Index stride = std::max<Eigen::Index>(1, transitions / kSamples);
  const Eigen::Index rows = (transitions + stride - 1) / stride;
  if (rows < kRowsPerColumn * (1 + n + m)) return "";
  Eigen::MatrixXd x = Eigen::MatrixXd::Ones(rows, 1 + n + m);
  Eigen::MatrixXd change(rows, n);
  std::vector<Eigen::MatrixXd> actions(2 + kMostLag, Eigen::MatrixXd(rows, m));
  Eigen::Index sample = 0;
  Eigen::Index row = 0;
  for (const core::Trajectory& d : demonstrations) {
    if (count(d) == 0) continue;
    const core::Matrix points = model.task().features().Apply(d.states);
    for (Eigen::Index t = kMostLag; t + 1 < d.controls.rows(); ++t, ++sample) {
      if (sample % stride != 0) continue;
      x.row(row).segment(1, n) = points.row(t);
      change.row(row) = points.row(t + 1) - points.row(t);
      for (Eigen::Index i = 0; i < std::ssize(actions); ++i) {
        actions[static_cast<std::size_t>(i)].row(row) = d.controls.row(t + 1 - i);
      }
      ++row;
    }
  }
  Eigen::MatrixXd later = x.leftCols(1 + n);
  later.rightCols(n) += change;
  actions[0] -= later * core::SolveLeastSquares(later, actions[0]);
  const Eigen::VectorXd open = Residuals(x.leftCols(1 + n), change);
  std::vector<Eigen::VectorXd> explained;
  explained.reserve(actions.size());
  for (const Eigen::MatrixXd& u : actions) {
    x.rightCols(m) = u;
    explained.emplace_back(1.0 - (Residuals(x, change).array() / open.array()));
  }
  const auto is_open = [&](Eigen::Index k) {
    return open[k] > kDetermined * change.col(k).squaredNorm();
  };
  bool in_step = false;
  for (Eigen::Index k = 0; k < n; ++k) {
    in_step = in_step || (is_open(k) && explained[1][k] - explained[0][k] > fit::kLagGain);
  }
  double best_gain = fit::kLagGain;
  std::size_t best = 1;
  Eigen::Index feature = 0;
  for (std::size_t i = in_step ? 2 : 0; i < explained.size(); ++i) {
    for (Eigen::Index k = 0; k < n; ++k) {
      const double gain = explained[i][k] - explained[1][k];
      if (!is_open(k) || !(gain > best_gain)) continue;
      best_gain = gain;
      best = i;
      feature = k;
    }
  }
  if (best == 1) return "";
  const int delay = static_cast<int>(best) - 1;
  const std::string shares =
      core::Format(" (%.0f %% explained; %.0f %% by the action of the same step)",
                   100.0 * explained[best][feature], 100.0 * std::max(0.0, explained[1][feature]));
  if (delay < 0) {
    return "the change of a state is explained by the action recorded one step later" + shares +
           ": actions and states are out of step, see guard check";
  }
  return core::Format("actions take effect %d step%s later", delay, delay == 1 ? "" : "s") +
         shares +
         (delay == 1 ? ": add the last action" : core::Format(": add the last %d actions", delay)) +
         " to the states, or pair each state with the action that moves it";
}

std::string DescribeJumps(const GuardModel& model,
                          std::span<const core::Trajectory> demonstrations) {
  constexpr double kFar = 10.0;
  std::vector<core::Matrix> changes;
  for (const core::Trajectory& d : demonstrations) {
    const Eigen::Index n = d.controls.rows();
    changes.emplace_back(d.states.middleRows(1, n) - d.states.topRows(n));
  }
  const core::FeatureSelection& selection = model.task().features().selection();
  for (const int entry : selection.indices()) {
    if (IsRotation(selection.map(), entry)) continue;
    const Largest jump = LargestOf(changes, entry);
    if (jump.others == 0.0 || jump.value <= kFar * jump.others) continue;
    return core::Format(
        "%s changes by %.3g at step %d of demonstration %zu, and by at most %.3g in all others: "
        "correct the recording, or leave the demonstration out",
        core::EntryName(model.task_layout(), entry).c_str(), jump.value,
        static_cast<int>(jump.step), jump.demonstration, jump.others);
  }
  return "";
}

std::string DescribeLargest(std::span<const core::Trajectory> demonstrations) {
  constexpr double kFar = 5.0;
  std::vector<core::Matrix> actions;
  for (const core::Trajectory& d : demonstrations) actions.push_back(d.controls);
  for (Eigen::Index i = 0; i < actions[0].cols(); ++i) {
    const Largest largest = LargestOf(actions, i);
    if (largest.others == 0.0 || largest.value <= kFar * largest.others) continue;
    return core::Format(
        "entry %d of action %d of demonstration %zu is %.3g, and at most %.3g in all others. The "
        "default limit follows from it: correct the recording, or set the action limit",
        static_cast<int>(i), static_cast<int>(largest.step), largest.demonstration, largest.value,
        largest.others);
  }
  return "";
}

std::string DescribeGoals(const GuardModel& model,
                          std::span<const core::Trajectory> demonstrations) {
  constexpr double kMostWithin = 0.1;  // share of the variance within demonstrations
  const GuardSummary& summary = model.summary();
  if (summary.acceptance >= fit::kLeastAcceptance && summary.changed <= fit::kMostChanged &&
      summary.ends_outside <= fit::kMostOutside) {
    return "";
  }
  double count = 0.0;
  for (const core::Trajectory& d : demonstrations) count += static_cast<double>(d.states.rows());
  std::vector<int> entries = model.task().features().selection().indices();
  entries.erase(std::unique(entries.begin(), entries.end()), entries.end());
  std::vector<int> goals;
  for (const int entry : entries) {
    const double origin = demonstrations[0].states(0, entry);
    double sum = 0.0;
    double squares = 0.0;
    double within = 0.0;
    for (const core::Trajectory& d : demonstrations) {
      const Eigen::ArrayXd x = d.states.col(entry).array() - origin;
      sum += x.sum();
      squares += x.square().sum();
      within += (x - x.mean()).square().sum();
    }
    const double all = squares - sum * sum / count;
    if (all > 0.0 && within <= kMostWithin * all) goals.push_back(entry);
  }
  if (goals.empty() || goals.size() == entries.size()) return "";
  return Names(model.task_layout(), goals) +
         ": nearly constant within a demonstration but different in others, like a goal. Use "
         "features relative to such entries, for example their difference from the tool. Without "
         "them the guard does not know the goal";
}

}  // namespace dfr::safety::internal
