#include "dfr/core/absolute_actions.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>

#include "dfr/core/format.h"
#include "dfr/core/linear_algebra.h"

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
      sum_(Eigen::VectorXd::Zero(m_ + 2 * n_)),
      products_(Eigen::MatrixXd::Zero(m_ + 2 * n_, m_ + 2 * n_)) {}

void ActionAnalysis::Add(const Trajectory& episode) {
  const Eigen::Index steps = episode.controls.rows();
  Eigen::MatrixXd rows(steps, m_ + 2 * n_);
  rows << episode.controls, episode.states.topRows(steps), episode.states.bottomRows(steps);
  sum_ += rows.colwise().sum().transpose();
  products_.noalias() += rows.transpose() * rows;
  count_ += static_cast<double>(steps);
}

std::vector<AbsoluteAction> ActionAnalysis::Absolute() const {
  constexpr double kSlope = 0.1;
  constexpr double kCorrelation = 0.9;
  constexpr double kOffset = 0.5;  // fraction of the spread
  constexpr double kMoves = 0.3;   // share of the changes that the distance to the target explains
  constexpr double kRepeats = 1e-3;  // fraction of the spread: the action repeats the state
  if (count_ < 8.0) return {};
  const Eigen::VectorXd mean = sum_ / count_;
  const Eigen::MatrixXd covariance = products_ / count_ - mean * mean.transpose();
  // Variance of a linear combination of (u_k, x_j(t), x_j(t + 1)), and covariance of two.
  std::vector<AbsoluteAction> found;
  for (Eigen::Index k = 0; k < m_; ++k) {
    const double var_u = covariance(k, k);
    if (!(var_u > 1e-12 * products_(k, k) / count_)) continue;  // constant
    std::optional<AbsoluteAction> best;
    double best_distance = 0.0;
    for (Eigen::Index j = 0; j < n_; ++j) {
      const Eigen::Index now = m_ + j;
      const Eigen::Index next = m_ + n_ + j;
      AbsoluteAction match{.action = static_cast<int>(k), .state = static_cast<int>(j)};
      bool fits = false;
      for (const Eigen::Index x : {now, next}) {
        const double var_x = covariance(x, x);
        if (!(var_x > 1e-12 * products_(x, x) / count_)) continue;
        const double slope = covariance(k, x) / var_x;
        const double correlation = covariance(k, x) / std::sqrt(var_u * var_x);
        if (std::abs(slope - 1.0) > kSlope || correlation < kCorrelation ||
            std::abs(mean[k] - mean[x]) > kOffset * std::sqrt(var_x)) {
          continue;
        }
        if (!fits || correlation > match.correlation) {
          match.slope = slope;
          match.correlation = correlation;
        }
        fits = true;
      }
      if (!fits) continue;
      // Share of the change that is towards the target: dx = x(t + 1) - x(t) on d = u - x(t).
      const double var_d = var_u - 2.0 * covariance(k, now) + covariance(now, now);
      const double var_dx =
          covariance(next, next) - 2.0 * covariance(next, now) + covariance(now, now);
      const double both =
          covariance(k, next) - covariance(k, now) - covariance(now, next) + covariance(now, now);
      match.leads = var_d > kRepeats * kRepeats * covariance(now, now);
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
  const Eigen::MatrixXd uu = products_.topLeftCorner(m_, m_);
  for (Eigen::Index p = 0; p < n_; ++p) {
    if (std::any_of(candidates.begin(), candidates.end(),
                    [p](const AbsoluteAction& match) { return match.state == p; })) {
      continue;
    }
    const Eigen::Index now = m_ + p;
    const Eigen::Index next = m_ + n_ + p;
    const double yy = products_(next, next) - 2.0 * products_(next, now) + products_(now, now);
    // Rounding residue of a constant entry is not a change.
    if (yy <= 1e-12 * products_(now, now)) continue;
    const Eigen::VectorXd uy = products_.col(next).head(m_) - products_.col(now).head(m_);
    if (ShareThroughOrigin(uu, uy, yy) >= kExplained) return true;
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
  for (std::size_t i = 0; i < absolute.size(); ++i) {
    correlation = std::min(correlation, absolute[i].correlation);
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
                correlation, absolute.empty() ? 1.0 : absolute[0].slope,
                one ? "it is a position" : "they are positions");
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
