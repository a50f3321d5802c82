#include "dfr/core/features/absolute_actions.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>

#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"

namespace dfr::core {
namespace {

// Share of a quantity's sum of squares (not variance) that a regression through the origin
// explains.
double ShareThroughOrigin(const Eigen::MatrixXd& uu, const Eigen::VectorXd& uy, double yy) {
  if (yy <= 0.0) return 0.0;
  Eigen::MatrixXd regular = uu;
  regular.diagonal().array() += 1e-9 * uu.trace() + 1e-300;
  return uy.dot(SolveSymmetric(regular, uy).col(0)) / yy;
}

}  // namespace

ActionAnalysis::ActionAnalysis(int state_dim, int control_dim)
    : n_(state_dim),
      m_(control_dim),
      actions_(Eigen::VectorXd::Zero(m_)),
      action_products_(Eigen::MatrixXd::Zero(m_, m_)),
      sum_(Eigen::VectorXd::Zero(2 * n_)),
      squares_(sum_),
      products_(Eigen::MatrixXd::Zero(m_, 2 * n_)),
      steps_(Eigen::VectorXd::Zero(n_)) {}

void ActionAnalysis::Add(const Trajectory& episode) {
  const Eigen::Index steps = episode.controls.rows();
  const auto now = episode.states.topRows(steps);
  const auto next = episode.states.bottomRows(steps);
  actions_ += episode.controls.colwise().sum().transpose();
  action_products_.noalias() += episode.controls.transpose() * episode.controls;
  sum_.head(n_) += now.colwise().sum().transpose();
  sum_.tail(n_) += next.colwise().sum().transpose();
  squares_.head(n_) += now.colwise().squaredNorm().transpose();
  squares_.tail(n_) += next.colwise().squaredNorm().transpose();
  products_.leftCols(n_).noalias() += episode.controls.transpose() * now;
  products_.rightCols(n_).noalias() += episode.controls.transpose() * next;
  steps_ += now.cwiseProduct(next).colwise().sum().transpose();
  count_ += static_cast<double>(steps);
}

std::vector<AbsoluteAction> ActionAnalysis::Absolute() const {
  constexpr double kSlope = 0.1;
  constexpr double kCorrelation = 0.9;
  constexpr double kOffset = 0.5;  // fraction of the spread
  constexpr double kMoves = 0.3;   // share of the changes that the distance to the target explains
  constexpr double kRepeats = 1e-3;  // fraction of the spread: the action repeats the state
  if (count_ < 8.0) return {};
  const Eigen::VectorXd mean_u = actions_ / count_;
  const Eigen::VectorXd mean_x = sum_ / count_;
  const Eigen::VectorXd variance = squares_ / count_ - mean_x.cwiseAbs2();
  std::vector<AbsoluteAction> found;
  for (Eigen::Index k = 0; k < m_; ++k) {
    const double square_u = action_products_(k, k) / count_;
    const double var_u = square_u - mean_u[k] * mean_u[k];
    if (!(var_u > 1e-12 * square_u)) continue;  // constant
    const auto with = [&](Eigen::Index x) {
      return products_(k, x) / count_ - mean_u[k] * mean_x[x];
    };
    std::optional<AbsoluteAction> best;
    double best_distance = 0.0;
    for (Eigen::Index j = 0; j < n_; ++j) {
      const Eigen::Index now = j;
      const Eigen::Index next = n_ + j;
      AbsoluteAction match{.action = static_cast<int>(k), .state = static_cast<int>(j)};
      bool fits = false;
      for (const Eigen::Index x : {now, next}) {
        const double var_x = variance[x];
        if (!(var_x > 1e-12 * squares_[x] / count_)) continue;
        const double slope = with(x) / var_x;
        const double correlation = with(x) / std::sqrt(var_u * var_x);
        if (std::abs(slope - 1.0) > kSlope || correlation < kCorrelation ||
            std::abs(mean_u[k] - mean_x[x]) > kOffset * std::sqrt(var_x)) {
          continue;
        }
        if (!fits || correlation > match.correlation) {
          match.slope = slope;
          match.correlation = correlation;
        }
        fits = true;
      }
      if (!fits) continue;
      // Regresses the change dx = x(t + 1) - x(t) on the distance to the target, d = u - x(t).
      const double var_now = variance[now];
      const double step = steps_[j] / count_ - mean_x[now] * mean_x[next];
      const double var_d = var_u - 2.0 * with(now) + var_now;
      const double var_dx = variance[next] - 2.0 * step + var_now;
      const double both = with(next) - with(now) - step + var_now;
      match.leads = var_d > kRepeats * kRepeats * var_now;
      const bool moves =
          var_d > 0.0 && var_dx > 0.0 && both > 0.0 && both * both / (var_d * var_dx) >= kMoves;
      if (match.leads && !moves) continue;
      if (!best || var_d < best_distance) {
        best = match;
        best_distance = var_d;
      }
    }
    if (best) found.push_back(*best);
  }
  return MovesUnmatchedEntry(found) ? std::vector<AbsoluteAction>() : found;
}

bool ActionAnalysis::MovesUnmatchedEntry(const std::vector<AbsoluteAction>& candidates) const {
  constexpr double kExplained = 0.8;
  if (candidates.empty()) return false;
  for (Eigen::Index p = 0; p < n_; ++p) {
    if (std::any_of(candidates.begin(), candidates.end(),
                    [p](const AbsoluteAction& match) { return match.state == p; })) {
      continue;
    }
    const double square = squares_[p];
    const double yy = squares_[n_ + p] - 2.0 * steps_[p] + square;
    // The rounding residue of a constant entry is not a change.
    if (yy <= 1e-12 * square) continue;
    const Eigen::VectorXd uy = products_.col(n_ + p) - products_.col(p);
    if (ShareThroughOrigin(action_products_, uy, yy) >= kExplained) return true;
  }
  return false;
}

std::vector<AbsoluteAction> FindAbsoluteActions(std::span<const Trajectory> demonstrations) {
  if (demonstrations.empty()) return {};
  ActionAnalysis analysis(static_cast<int>(demonstrations[0].states.cols()),
                          static_cast<int>(demonstrations[0].controls.cols()));
  for (const Trajectory& episode : demonstrations) analysis.Add(episode);
  return analysis.Absolute();
}

void ToDifferences(std::span<const AbsoluteAction> absolute, Trajectory& episode) {
  const Eigen::Index steps = episode.controls.rows();
  for (const AbsoluteAction& entry : absolute) {
    auto u = episode.controls.col(entry.action);
    const auto x = episode.states.col(entry.state);
    if (!entry.leads) u = x.tail(steps);
    u -= x.head(steps);
  }
}

std::string Describe(std::span<const AbsoluteAction> absolute, const StateLayout& layout) {
  constexpr std::size_t kMost = 3;
  std::string actions;
  std::string entries;
  double correlation = 1.0;
  double slope = 1.0;  // the one furthest from 1
  for (std::size_t i = 0; i < absolute.size(); ++i) {
    correlation = std::min(correlation, absolute[i].correlation);
    if (std::abs(absolute[i].slope - 1.0) > std::abs(slope - 1.0)) slope = absolute[i].slope;
    if (i > kMost) continue;
    const char* separator = i == 0 ? "" : ", ";
    actions += separator;
    entries += separator;
    actions += i == kMost ? "..." : std::to_string(absolute[i].action);
    entries += i == kMost ? "..." : EntryName(layout, absolute[i].state);
  }
  const bool one = absolute.size() == 1;
  return Format("%s %s take%s the values of %s (correlation at least %.3f, slope %.2f): %s",
                one ? "action" : "actions", actions.c_str(), one ? "s" : "", entries.c_str(),
                correlation, slope, one ? "it is a position" : "they are positions");
}

std::string EntryName(const StateLayout& layout, Eigen::Index entry) {
  for (const auto& block : layout.blocks) {
    if (entry >= block.offset && entry < block.offset + block.size) {
      return Format("%s[%ld]", block.name.c_str(), static_cast<long>(entry - block.offset));
    }
  }
  return Format("state[%ld]", static_cast<long>(entry));
}

}  // namespace dfr::core
