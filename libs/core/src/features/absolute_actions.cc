#include "dfr/core/features/absolute_actions.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>

#include "dfr/core/numerics/linear_algebra.h"
#include "dfr/core/text/format.h"

namespace dfr::core {
namespace {

// Returns the share of `yy` that a regression on u explains. `uu`, `uy` and `yy` are sums of
// products. If the sums are centred, the share refers to the variance, otherwise to the squares.
double Share(const Eigen::MatrixXd& uu, const Eigen::VectorXd& uy, double yy) {
  if (uu.size() == 0 || yy <= 0.0) return 0.0;
  Eigen::MatrixXd regular = uu;
  // Ridge relative to each entry, because the entries have different units.
  regular.diagonal() += 1e-9 * uu.diagonal();
  regular.diagonal().array() += 1e-300;
  return uy.dot(SolveSymmetric(regular, uy).col(0)) / yy;
}

StateLayout SeparateEntries(int count) {
  StateLayout layout;
  for (int i = 0; i < count; ++i) layout.Add(std::to_string(i), 1);
  return layout;
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
      steps_(Eigen::VectorXd::Zero(n_)),
      deviations_(Eigen::MatrixXd::Zero((kMostLag + 1) * m_, n_)),
      largest_(Eigen::VectorXd::Zero(m_)),
      values_(static_cast<std::size_t>(m_ + n_)),
      history_(Eigen::VectorXd::Zero((kMostLag + 2) * m_)),
      history_products_(Eigen::MatrixXd::Zero(history_.size(), history_.size())),
      history_changes_(Eigen::MatrixXd::Zero(history_.size(), n_)),
      changes_(steps_),
      change_squares_(steps_),
      angles_(SeparateEntries(state_dim)) {}

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
  angles_.Add(episode.states);
  AddValues(episode.controls, 0);
  AddValues(episode.states, static_cast<std::size_t>(m_));
  AddHistory(episode);
}

void ActionAnalysis::AddValues(const Matrix& rows, std::size_t first) {
  for (Eigen::Index k = 0; k < rows.cols(); ++k) {
    std::vector<double>& values = values_[first + static_cast<std::size_t>(k)];
    for (Eigen::Index t = 0; t < rows.rows() && values.size() <= kMostFew; ++t) {
      if (std::ranges::find(values, rows(t, k)) == values.end()) values.push_back(rows(t, k));
    }
  }
}

bool ActionAnalysis::HasFewValues(std::size_t i) const {
  constexpr double kLeastRepeated = 5.0;
  return values_[i].size() <= kMostFew &&
         kLeastRepeated * static_cast<double>(values_[i].size()) <= count_;
}

void ActionAnalysis::AddHistory(const Trajectory& episode) {
  const Eigen::Index steps = episode.controls.rows();
  if (steps == 0) return;
  largest_ = largest_.cwiseMax(episode.controls.cwiseAbs().colwise().maxCoeff().transpose());
  for (Eigen::Index i = 0; i <= std::min(kMostLag, steps - 1); ++i) {
    const auto later = episode.states.bottomRows(steps - i);
    for (Eigen::Index k = 0; k < m_; ++k) {
      auto most = deviations_.row(i * m_ + k);
      most = most.cwiseMax((later.colwise() - episode.controls.col(k).head(steps - i))
                               .cwiseAbs()
                               .colwise()
                               .maxCoeff());
    }
  }
  const Eigen::Index rows = steps - kMostLag - 1;
  if (rows <= 0) return;
  Eigen::MatrixXd past(rows, history_.size());
  for (Eigen::Index i = 0; i <= kMostLag + 1; ++i) {
    past.middleCols(i * m_, m_) = episode.controls.middleRows(kMostLag + 1 - i, rows);
  }
  const auto next = episode.states.bottomRows(rows);
  const auto now = episode.states.middleRows(kMostLag + 1, rows);
  history_count_ += static_cast<double>(rows);
  history_ += past.colwise().sum().transpose();
  history_products_.noalias() += past.transpose() * past;
  history_changes_.noalias() += past.transpose() * next;
  history_changes_.noalias() -= past.transpose() * now;
  changes_ += (next - now).colwise().sum().transpose();
  change_squares_ += (next - now).colwise().squaredNorm().transpose();
}

Eigen::VectorXd ActionAnalysis::ExplainedBy(Eigen::Index k, Eigen::Index lag,
                                            bool difference) const {
  const Eigen::Index size = history_.size();
  Eigen::MatrixXd select = Eigen::MatrixXd::Zero(size, m_);  // One column per entry, entry k last.
  for (Eigen::Index i = 0; i < m_; ++i) {
    const Eigen::Index column = i == k ? m_ - 1 : i - (i > k ? 1 : 0);
    select(lag * m_ + i, column) = 1.0;
    if (difference) select((lag + 1) * m_ + i, column) = -1.0;
  }
  const Eigen::MatrixXd covariance =
      select.transpose() *
      (history_products_ / history_count_ -
       history_ * history_.transpose() / history_count_ / history_count_) *
      select;
  const Eigen::MatrixXd with_changes =
      select.transpose() * (history_changes_ / history_count_ -
                            history_ * changes_.transpose() / history_count_ / history_count_);
  const Eigen::ArrayXd variance =
      change_squares_.array() / history_count_ - (changes_.array() / history_count_).square();
  const auto left = [&](Eigen::Index count) {
    const Eigen::MatrixXd y = with_changes.topRows(count);
    Eigen::ArrayXd explained = Eigen::ArrayXd::Zero(n_);
    if (count > 0) {
      explained = y.cwiseProduct(SolveSymmetric(covariance.topLeftCorner(count, count), y))
                      .colwise()
                      .sum()
                      .transpose();
    }
    return Eigen::ArrayXd(variance - explained);
  };
  const Eigen::ArrayXd others = left(m_ - 1);
  // If the other actions explain a change, only a rounding residue is left, which is not a change.
  return (others > 1e-9 * change_squares_.array() / history_count_)
      .select(1.0 - left(m_) / others, 0.0);
}

std::vector<bool> ActionAnalysis::FindPastActions() const {
  constexpr double kRounding = 1e-6;  // single precision, as a fraction of the largest action
  constexpr double kRowsPerEntry = 10.0;
  constexpr double kExplained = 0.5;
  constexpr double kLeaves = 0.5;  // fraction of the variance that differences leave unexplained
  std::vector<bool> past(static_cast<std::size_t>(n_), false);
  if (history_count_ < kRowsPerEntry * static_cast<double>(m_ + 1)) return past;
  std::vector<std::vector<Eigen::Index>> copies(static_cast<std::size_t>(m_));
  std::vector<bool> repeats = past;
  const auto repeat = [&](Eigen::Index j, Eigen::Index k, Eigen::Index lag) {
    return deviations_(lag * m_ + k, j) <= kRounding * largest_[k];
  };
  for (Eigen::Index k = 0; k < m_; ++k) {
    for (Eigen::Index j = 0; j < n_; ++j) {
      for (Eigen::Index i = 0; i <= kMostLag; ++i) {
        if (!repeat(j, k, i)) continue;
        copies[static_cast<std::size_t>(k)].push_back(j);
        repeats[static_cast<std::size_t>(j)] = true;
        break;
      }
    }
  }
  for (Eigen::Index k = 0; k < m_; ++k) {
    const std::vector<Eigen::Index>& own = copies[static_cast<std::size_t>(k)];
    if (own.empty()) continue;
    Eigen::VectorXd as_velocity = Eigen::VectorXd::Zero(n_);
    Eigen::VectorXd as_target = as_velocity;
    for (Eigen::Index lag = 0; lag <= kMostLag; ++lag) {
      as_velocity = as_velocity.cwiseMax(ExplainedBy(k, lag, false));
      as_target = as_target.cwiseMax(ExplainedBy(k, lag, true));
    }
    bool moves = false;
    for (Eigen::Index p = 0; p < n_; ++p) {
      moves = moves || (!repeats[static_cast<std::size_t>(p)] && as_velocity[p] >= kExplained &&
                        1.0 - as_velocity[p] <= kLeaves * (1.0 - as_target[p]));
    }
    if (!moves) continue;
    for (const Eigen::Index j : own) past[static_cast<std::size_t>(j)] = true;
  }
  // A block of entries that repeats the whole action is one observation.
  for (Eigen::Index first = 0; first + m_ <= n_; ++first) {
    const auto block = past.begin() + first;
    if (2 * std::count(block, block + m_, true) < m_) continue;
    for (Eigen::Index i = 0; i <= kMostLag; ++i) {
      bool whole = true;
      for (Eigen::Index k = 0; k < m_; ++k) whole = whole && repeat(first + k, k, i);
      if (whole) std::fill(block, block + m_, true);
    }
  }
  return past;
}

std::vector<AbsoluteAction> ActionAnalysis::Absolute() const {
  constexpr double kSlope = 0.1;
  constexpr double kCorrelation = 0.9;
  constexpr double kOffset = 0.5;  // largest offset, as a fraction of the spread
  constexpr double kMoves = 0.3;   // share of the changes that the distance to the target explains
  constexpr double kRepeats = 1e-3;  // fraction of the spread, for an action that repeats the state
  if (count_ < 8.0) return {};
  const Eigen::VectorXd mean_u = actions_ / count_;
  const Eigen::VectorXd mean_x = sum_ / count_;
  const Eigen::VectorXd variance = squares_ / count_ - mean_x.cwiseAbs2();
  const std::vector<bool> past = FindPastActions();
  bool all_few = true;
  for (std::size_t k = 0; k < static_cast<std::size_t>(m_); ++k) {
    all_few = all_few && HasFewValues(k);
  }
  std::vector<AbsoluteAction> found;
  for (Eigen::Index k = 0; k < m_; ++k) {
    const double square_u = action_products_(k, k) / count_;
    const double var_u = square_u - mean_u[k] * mean_u[k];
    if (!(var_u > 1e-12 * square_u)) continue;  // constant
    const bool few = HasFewValues(static_cast<std::size_t>(k));
    if (few && !all_few) continue;
    const auto with = [&](Eigen::Index x) {
      return products_(k, x) / count_ - mean_u[k] * mean_x[x];
    };
    std::optional<AbsoluteAction> best;
    double best_distance = 0.0;
    for (Eigen::Index j = 0; j < n_; ++j) {
      if (past[static_cast<std::size_t>(j)]) continue;
      if (few && HasFewValues(static_cast<std::size_t>(m_ + j))) continue;
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
  if (found.empty() || MovesUnmatchedEntry(found)) return {};
  for (const Rotation& angle : angles_.Find()) {
    if (angle.kind != Rotation::Kind::kAngle) continue;
    for (AbsoluteAction& match : found) {
      if (match.state == angle.first) match.period = angle.period;
    }
  }
  return found;
}

bool ActionAnalysis::MovesUnmatchedEntry(const std::vector<AbsoluteAction>& candidates) const {
  constexpr double kExplained = 0.8;  // share of the part that the other actions do not explain
  constexpr double kAdds = 0.1;
  if (candidates.empty()) return false;
  std::vector<Eigen::Index> others;
  for (Eigen::Index k = 0; k < m_; ++k) {
    if (std::none_of(candidates.begin(), candidates.end(),
                     [k](const AbsoluteAction& match) { return match.action == k; })) {
      others.push_back(k);
    }
  }
  const Eigen::MatrixXd uu = action_products_ - actions_ * actions_.transpose() / count_;
  for (Eigen::Index p = 0; p < n_; ++p) {
    if (std::any_of(candidates.begin(), candidates.end(),
                    [p](const AbsoluteAction& match) { return match.state == p; })) {
      continue;
    }
    const double square = squares_[p];
    const double yy = squares_[n_ + p] - 2.0 * steps_[p] + square;
    // The rounding residue of a constant entry is not a change.
    if (yy <= 1e-12 * square) continue;
    // An entry that moves by itself, such as an object on a conveyor, has a mean change. Actions
    // with a nonzero mean would explain it.
    const double sum = sum_[n_ + p] - sum_[p];
    const double variance = yy - sum * sum / count_;
    if (variance <= 1e-12 * yy) continue;
    const Eigen::VectorXd uy = products_.col(n_ + p) - products_.col(p) - actions_ * sum / count_;
    const double by_all = Share(uu, uy, variance);
    const double by_others = Share(uu(others, others), uy(others), variance);
    if (by_all - by_others >= std::max(kAdds, kExplained * (1.0 - by_others))) return true;
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
    if (entry.period > 0.0) {
      u = u.unaryExpr([&](double step) { return std::remainder(step, entry.period); }).eval();
    }
  }
}

std::string Describe(std::span<const AbsoluteAction> absolute, const StateLayout& layout) {
  constexpr std::size_t kMost = 3;
  std::string actions;
  std::string entries;
  double correlation = 1.0;
  double slope = 1.0;  // the slope furthest from 1
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
